"""What metadata and side files say of a detector; what they cannot say is one sentence."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.saliency import description
from operators.saliency.description import Description, described, of_metadata, over, side_file
from pipeline.errors import WeightsError
from pipeline.weights import MANIFEST
from tests.shared_data import Footage

WEIGHTS = Path("best.onnx")
ULTRALYTICS = {
    "description": "Ultralytics YOLO11n model trained on coco.yaml",
    "stride": "32",
    "task": "detect",
    "batch": "1",
    "imgsz": "[384, 640]",
    "names": "{0: 'person', 1: \"hairdresser's chair\", 2: 'dog'}",
    "args": "{'batch': 1, 'half': False, 'nms': True}",
}
KEYS = ("names", "imgsz", "stride", "confidence", "task", "domain", "trained_on")
NAMES = st.text("abc '\"\\é", min_size=1, max_size=8).filter(str.strip)


def laid(tmp_path: Path, text: str, known: Description | None = None) -> Description:
    """A description with a side file laid over it."""
    path = tmp_path / "best.yaml"
    path.write_text(text, encoding="utf-8")
    return over(known or Description(), path)


def refusal(read: Callable[[], object]) -> str:
    """The sentence that refuses what is read, "" where it is read."""
    try:
        read()
    except WeightsError as error:
        return str(error)
    return ""


def test_what_ultralytics_writes_is_read() -> None:
    known = of_metadata(WEIGHTS, ULTRALYTICS)

    assert known.names == ("person", "hairdresser's chair", "dog")
    assert known.exported_px == (640, 384)  # it writes the height first
    assert (known.task, known.stride_px) == ("detect", 32)


@given(st.lists(NAMES, min_size=1, max_size=9))
def test_names_of_any_spelling_are_read_from_a_table_and_a_list(names: list[str]) -> None:
    for text in (repr(dict(enumerate(names))), repr(names)):
        assert of_metadata(WEIGHTS, {"names": text}).names == tuple(names)


def test_other_exporters_tables_and_sizes_are_read() -> None:
    known = of_metadata(WEIGHTS, {"names": '{"1": "dog", "0": "person"}', "imgsz": "640"})

    assert (known.names, known.exported_px) == (("person", "dog"), (640, 640))


@pytest.mark.parametrize(
    ("key", "text", "sentence"),
    [
        ("names", "person", "metadata names: expected a value at character 1, got 'person'"),
        ("names", "{0: 'a', 2: 'b'}", "metadata names: expected the keys 0 to 1, got [0, 2]"),
        ("names", "{'a': 'b'}", "metadata names: expected numbers as keys, got ['a']"),
        ("names", "3", "metadata names: expected a table or a list of names, got 3"),
        ("names", "['a', None]", "metadata names: expected a name of class 1, got None"),
        ("names", "['a', ' ']", "metadata names: expected a name of class 1, got ' '"),
        ("names", r"['\n']", r"metadata names: expected a name of class 0, got '\n'"),
        ("names", repr(["a" * 101]), "expected names of up to 100 characters, got 101: 'aaa"),
        ("names", repr(list(range(20_001))), "expected up to 20000 names, got 20001"),
        ("imgsz", "[640]", "metadata imgsz: expected height and width, got [640]"),
        ("imgsz", "[0, 640]", "metadata imgsz: expected a width and a height of 1 to 8192"),
        ("imgsz", "1000000", "expected a width and a height of 1 to 8192, got (1000000, 1000000)"),
        ("stride", "0", "metadata stride: expected a whole number of 1 to 512, got 0"),
        ("stride", "[8, 16]", "metadata stride: expected a whole number of 1 to 512, got [8, 16]"),
        ("task", "segment", "expected a detector (task detect or obb), got one whose metadata"),
        ("confidence", "{'dgo': 0.5}", "metadata confidence: expected classes among the names"),
    ],
)
def test_metadata_that_says_nothing_sensible_is_refused(key: str, text: str, sentence: str) -> None:
    with pytest.raises(WeightsError) as caught:
        of_metadata(WEIGHTS, {key: text})

    assert str(caught.value).startswith("best.onnx: ")
    assert sentence in str(caught.value)


@given(st.dictionaries(st.sampled_from(KEYS), st.text(max_size=40)))
def test_any_metadata_is_read_or_refused_in_a_sentence(metadata: dict[str, str]) -> None:
    sentence = refusal(lambda: of_metadata(WEIGHTS, metadata))

    assert not sentence or sentence.startswith("best.onnx: ")
    assert "\n" not in sentence


def test_a_side_file_precedes_the_metadata(tmp_path: Path) -> None:
    known = of_metadata(WEIGHTS, ULTRALYTICS | {"confidence": "{'dog': 0.5}"})

    found = laid(
        tmp_path,
        "names: [person, cup, cat]\ninput_px: [320, 192]\nformat: yolo\nconfidence: 0.4\n"
        "class_confidence: {cat: 0.3}\ntrained_on: my flat\ndomain: home\n",
        known,
    )

    assert found.names == ("person", "cup", "cat")
    assert (found.input_px, found.format, found.confidence) == ((320, 192), "yolo", 0.4)
    assert found.class_confidence == {"cat": 0.3}  # what the export says is for other names
    assert (found.trained_on, found.domain) == ("my flat", "home")


def test_what_a_side_file_leaves_out_comes_from_the_metadata(tmp_path: Path) -> None:
    known = of_metadata(WEIGHTS, ULTRALYTICS | {"confidence": "{'dog': 0.5}"})

    found = laid(tmp_path, "trained_on: COCO\n", known)

    assert found.names == known.names
    assert found.class_confidence == {"dog": 0.5}
    assert found.exported_px == (640, 384)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("names: [a]\nconfidence: 2\n", "best.yaml:2: detector.confidence: must be within 0..1"),
        ("format: yolov5\n", "best.yaml:1: detector.format: input should be 'auto', 'yolo'"),
        ("\ninput_px: [640]\n", "best.yaml:2: detector.input_px"),
        ("input_px: [0, 640]\n", "best.yaml:1: detector.input_px: expected a width and a height"),
        ("names: person\n", "best.yaml:1: detector.names: input should be a valid"),
        ("names: [person, 3]\n", "best.yaml:1: detector.names.1: input should be a valid string"),
        ("names: ['']\n", "best.yaml:1: detector.names: expected a name of class 0, got ''"),
        ("name: [a]\n", "best.yaml:1: detector.name: no such setting, did you mean 'names'?"),
        ("names: [a]\nnames: [b]\n", "best.yaml:2: expected every key once, got names again"),
        ("names: {0: a}\n", "best.yaml:1: expected a text as key, got 0"),
        ("names: [a\n", "best.yaml:"),
        ("- a\n", "best.yaml:1: expected a mapping, got list"),
        ("", "best.yaml:1: expected a mapping, got nothing"),
        ("names: !!python/name:os.system [a]\n", "best.yaml:1: expected no tag"),
        ("names: [a]\nclass_confidence: {b: 0.5}\n", "best.yaml:2: detector.class_confidence: exp"),
        ("trained_on: 'a\\tb'\n", ""),
        ('trained_on: "a\\tb"\n', "best.yaml:1: detector.trained_on: expected one line of up to"),
    ],
)
def test_a_wrong_side_file_is_refused_with_file_and_line(
    tmp_path: Path, text: str, sentence: str
) -> None:
    if not sentence:
        assert laid(tmp_path, text).trained_on == "a\\tb"
        return
    with pytest.raises(WeightsError) as caught:
        laid(tmp_path, text)

    assert sentence in str(caught.value)


@given(
    st.text(st.characters(exclude_categories=["Cs"]), max_size=80)
    | st.builds(
        "{}: {}\n".format,
        st.sampled_from(("names", "input_px", "format", "confidence", "class_confidence")),
        st.text("ab01.,:[]{}'\"- ", max_size=20),
    )
)
def test_any_side_file_is_read_or_refused_with_its_name(text: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "best.yaml"
        path.write_text(text, encoding="utf-8")

        sentence = refusal(lambda: over(Description(), path))

        assert not sentence or sentence.startswith(str(path))


def test_a_side_file_is_found_beside_the_weights(tmp_path: Path) -> None:
    (tmp_path / "best.yaml").write_text("names: [cup]\n")

    assert described(tmp_path / "best.onnx", {}).names == ("cup",)
    assert described(tmp_path / "other.onnx", {}).names == ()


def test_every_side_file_shipped_is_of_third_party_weights_and_is_valid() -> None:
    shipped = sorted(Path(description.__file__).parent.glob("*.yaml"))
    known = tomllib.loads(MANIFEST.read_text())

    assert shipped
    for path in shipped:
        assert path.stem in known
        assert over(Description(), path).names


def test_yolox_nano_knows_the_classes_of_coco() -> None:
    path = Path(description.__file__).with_name("yolox_nano.yaml")

    names = over(Description(), path).names

    assert len(set(names)) == len(names) == 80
    # the numbers by which COCO's detectors are commonly read
    assert [names.index(n) for n in ("person", "dog", "sports ball", "toothbrush")] == [
        0, 16, 32, 79,
    ]  # fmt: skip


def test_a_file_that_only_has_the_name_of_third_party_weights_is_not_taken_for_them(
    tmp_path: Path,
) -> None:
    (tmp_path / "yolox_nano_416.onnx").write_bytes(b"something else")

    assert side_file(tmp_path / "yolox_nano_416.onnx") == tmp_path / "yolox_nano_416.yaml"


@pytest.mark.footage
def test_third_party_weights_are_known_wherever_they_lie(footage: Footage) -> None:
    (found,) = footage.mirror().rglob("yolox_nano_416.onnx")

    assert len(described(found, {}).names) == 80
