"""Data sets of texts: labels of pictures, RoadText videos, photographs panned over."""

import json
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.datasets import PannedPictures, RoadTextVideo
from drivers.datasets.texts.files import Place, line_of
from drivers.datasets.texts.labels import (
    ILLEGIBLE,
    Label,
    labels_beside,
    read_icdar,
    read_labelme,
    read_textocr,
    read_total_text,
)
from drivers.datasets.texts.roadtext import read_roadtext, write_roadtext
from pipeline.errors import DriverError, SettingsError
from tests.shared_data import Footage

SQUARE = [[10, 20], [60, 20], [60, 40], [10, 40]]


LONG_POINT = f'{{"shapes": [{{"label": "A", "points": [[1{"0" * 400}, 1], [2, 2], [3, 1]]}}]}}'


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def told(labels: list[Label]) -> list[tuple[str, list[list[float]]]]:
    return [(label.text, label.outline.tolist()) for label in labels]


def test_icdar_2015_is_read_with_commas_and_mark(tmp_path: Path) -> None:
    path = written(
        tmp_path / "gt.txt", "\ufeff10,20,60,20,60,40,10,40,A, B\n1,1,9,1,9,5,1,5,###\n\n"
    )

    labels = read_icdar(path)

    assert told(labels)[0] == ("A, B", SQUARE)
    assert labels[1].text == ILLEGIBLE


@pytest.mark.parametrize("line", ['10 20 60 40 "STOP"', '10, 20, 60, 40, "STOP"'])
def test_icdar_2013_is_read(tmp_path: Path, line: str) -> None:
    assert told(read_icdar(written(tmp_path / "gt.txt", line))) == [("STOP", SQUARE)]


def test_labelme_is_read(tmp_path: Path) -> None:
    shape = {"label": "STOP", "points": SQUARE}

    assert told(read_labelme(written(tmp_path / "a.json", json.dumps({"shapes": [shape]})))) == [
        ("STOP", SQUARE)
    ]


def test_total_text_is_read_across_broken_lines(tmp_path: Path) -> None:
    text = (
        "x: [[ 10 60\n 60 10]], y: [[20 20 40 40]], ornt: [u'm'], transcriptions: [u'STOP']\n"
        "x: [[1 9 9]], y: [[1 1 5]], ornt: [u'#'], transcriptions: [u'#']\n"
    )

    labels = read_total_text(written(tmp_path / "poly_gt_img1.txt", text))

    assert told(labels)[0] == ("STOP", SQUARE)
    assert labels[1].text == ILLEGIBLE


def test_textocr_takes_boxes_from_points(tmp_path: Path) -> None:
    flat = [value for point in SQUARE for value in point]
    document = {
        "imgs": {"a": {"id": "a", "file_name": "train/a.jpg"}},
        "anns": {
            "a_1": {"image_id": "a", "bbox": [0, 0, 1, 1], "points": flat, "utf8_string": "STOP"},
            "a_2": {"image_id": "a", "points": flat, "utf8_string": "."},
        },
    }

    labels = read_textocr(written(tmp_path / "t.json", json.dumps(document)))["a.jpg"]

    assert told(labels)[0] == ("STOP", SQUARE)
    assert labels[1].text == ILLEGIBLE


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("gt.txt", "1,2,3,4,5,6,7,8,A\n1,2,3\n", r"gt\.txt:2: expected x1,y1"),
        ("gt.txt", "1,2,3,4,5,6,7,x,A\n", r"gt\.txt:1: expected numbers"),
        ("gt.txt", "1,2,3,4,5,6,7,inf,A\n", r"gt\.txt:1: expected pixels"),
        ("a.json", '{"shapes": [\n{]', r"a\.json:2: expected JSON"),
        ("a.json", '{"shapes": [{"label": 3}]}', r"a\.json:1: shapes\[0\]: expected points"),
        ("a.json", '{"shapes": [\n{"label": "A", "points": [[1, 2], 3]}]}',
         r"a\.json:2: shapes\[0\]\.points: expected pairs"),
        ("a.json", '{"shapes": [{"label": "A", "points": [[1, 2]]}]}', "at least three points"),
        ("poly_gt.txt", "x: [[1 2]]\n", r"poly_gt\.txt:1: expected transcriptions"),
        ("poly_gt.txt", "x: [[1 2 3]], y: [[1 2]], ornt: [u'm'], transcriptions: [u'A']",
         "as many x as y, got 3 and 2"),
        ("t.json", '{"imgs": {},\n"anns": {"1":\n{"image_id": "b"}}}',
         r"t\.json:3: anns\.1: expected an image_id of imgs"),
        ("t.json", '{"anns": {}}', r"t\.json: expected imgs, dict, got None"),
    ],
)  # fmt: skip
def test_malformed_files_are_refused_with_file_and_line(
    tmp_path: Path, name: str, text: str, sentence: str
) -> None:
    readers = {"g": read_icdar, "a": read_labelme, "p": read_total_text, "t": read_textocr}

    with pytest.raises(DriverError, match=sentence):
        readers[name[0]](written(tmp_path / name, text))


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("gt.txt", "x" * 200_000, r"gt\.txt:1: expected a line of at most"),
        ("gt.txt", f"1,2,3,4,5,6,7,{'9' * 400},A", r"gt\.txt:1: expected pixels"),
        ("a.json", LONG_POINT, r"a\.json:1: .*expected numbers"),
        ("a.json", f'{{"shapes": {"9" * 5000}}}', "expected JSON with numbers of at most 4300"),
        ("poly_gt.txt", "0123456789\n" * 200_000, r"poly_gt\.txt:1: expected a text of at most"),
    ],
)
def test_huge_numbers_and_lines_are_refused_at_once_with_file_and_line(
    tmp_path: Path, name: str, text: str, sentence: str
) -> None:
    readers = {"g": read_icdar, "a": read_labelme, "p": read_total_text}
    path = written(tmp_path / name, text)
    began = time.process_time()

    with pytest.raises(DriverError, match=sentence):
        readers[name[0]](path)
    assert time.process_time() - began < 1


@settings(max_examples=60)
@given(st.text(max_size=200))
def test_any_other_text_is_refused_or_read_but_never_a_crash(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    folder = tmp_path_factory.mktemp("any")
    for name, read in (
        ("gt.txt", read_icdar),
        ("p.txt", read_total_text),
        ("a.json", read_labelme),
    ):
        path = folder / name
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        try:
            found = read(path)
        except DriverError:
            continue
        assert all(label.outline.shape[0] >= 3 for label in found)


def photographs(folder: Path, count: int = 2) -> Path:
    for number in range(count):
        drawn = np.full((180, 320, 3), 60 + 40 * number, np.uint8)
        drawn[80:100, 100:200] = 250
        cv2.imwrite(str(folder / f"img_{number}.png"), drawn)
        rows = "100,80,200,80,200,100,100,100,BANK\n100,120,110,120,110,123,100,123,tiny\n"
        written(folder / f"gt_img_{number}.txt", rows)
    return folder


def test_a_photograph_comes_nearer_and_its_text_is_where_the_truth_says(tmp_path: Path) -> None:
    source = PannedPictures(path=str(photographs(tmp_path)), frames_each=5)
    widths = []

    for index in range(5):
        truth, picture = source.truth(index), source.picture(index)
        row = truth.ids.tolist().index(0)
        x0, y0, x1, y1 = truth.boxes[row].round().astype(int)
        widths.append(x1 - x0)
        assert picture[y0 + 2 : y1 - 2, x0 + 2 : x1 - 2].mean() > 220
        assert picture[max(0, y0 - 8) : y0 - 3, x0:x1].mean() < 120

    assert widths == sorted(widths)
    assert widths[-1] == pytest.approx(100, abs=1)
    assert source.length == 10


def test_small_texts_and_those_of_the_next_photograph_are_told_apart(tmp_path: Path) -> None:
    source = PannedPictures(path=str(photographs(tmp_path)), frames_each=5)

    first, last = source.truth(4), source.truth(9)

    assert dict(zip(first.ids.tolist(), first.labels, strict=True)) == {0: "BANK", 1: ILLEGIBLE}
    assert not set(first.ids.tolist()) & set(last.ids.tolist())


def test_photographs_without_labels_are_refused_together(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((20, 30, 3), np.uint8))

    with pytest.raises(DriverError, match=r"expected photographs with labels.*got 1 without"):
        PannedPictures(path=str(tmp_path))


@pytest.mark.parametrize("options", [{"frames_each": 0}, {"rate_hz": 0.0}, {"seed": -1}])
def test_settings_out_of_range_are_refused(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="frames_each, seed, rate_hz: expected"):
        PannedPictures(path=str(tmp_path), **options)


BOX = {"x1": 1, "y1": 2, "x2": 30, "y2": 12}
LABEL = {"box2d": BOX, "category": "English", "id": 4, "ocr": "BANK"}


def test_the_challenge_release_counts_frames_from_1(tmp_path: Path) -> None:
    path = written(
        tmp_path / "t.json", json.dumps({"7": {"1": {"labels": None}, "2": {"labels": [LABEL]}}})
    )

    rows = read_roadtext(path, "7")

    assert rows[0] == []
    assert rows[1] == [([1, 2, 30, 12], 4, "BANK")]


def test_the_original_release_takes_texts_from_a_second_file(tmp_path: Path) -> None:
    labels = [
        {"id": 4, "category": "English_Legible", "box2d": BOX},
        {"id": 5, "category": "Illegible", "box2d": BOX},
    ]
    frames = [{"name": "a/7-0000001.jpg", "videoName": "7.mp4", "index": 0, "labels": labels}]
    path = written(tmp_path / "r.json", json.dumps(frames))
    said = written(tmp_path / "s.json", json.dumps({"4": "BANK", "5": "no"}))

    assert [row[1:] for row in read_roadtext(path, "7", str(said))[0]] == [
        (4, "BANK"), (5, ILLEGIBLE)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"8": {}}, "expected a video 7, got 8"),
        ({"7": []}, "expected frames by number"),
        ({"7": {"0": {"labels": None}}}, r"t\.json:3: 7\.0: expected a frame from 1"),
        ({"7": {"1": {"labels": [{}]}}}, r"t\.json:5: 7\.1\.labels\[0\]: expected box2d"),
        ({"7": {"1": {"labels": [LABEL | {"category": "Klingon"}]}}}, "expected category"),
        ({"7": {"1": {"labels": [LABEL | {"id": "x"}]}}}, "expected a number as id"),
        ({"7": {"1": {"labels": [LABEL | {"box2d": BOX | {"x2": 0}}]}}}, "x2 after x1"),
        ({"7": {"²": {"labels": None}}}, "expected a frame from 1"),
        ({"7": {"9" * 5000: {"labels": None}}}, "expected a frame from 1"),
        ({"7": {"1": {"labels": [LABEL | {"id": float("inf")}]}}}, "expected a number as id"),
        ({"7": {"1": {"labels": [LABEL | {"id": 10**4000}]}}}, "expected an id of 0 to"),
        ({"7": {"1": {"labels": [LABEL | {"box2d": BOX | {"x1": 10**400}}]}}}, "expected box2d"),
        ([{"videoName": "7", "index": 10**4299}], "expected an index from 0"),
        ([{"videoName": "7", "index": -1}], r"t\.json:2: \[0\]: expected an index from 0"),
        ([], "expected a video 7, got none"),
        (3, "expected a list or videos by name"),
    ],
)
def test_malformed_truth_is_refused_with_its_line(
    tmp_path: Path, document: Any, sentence: str
) -> None:
    path = written(tmp_path / "t.json", json.dumps(document, indent=1))

    with pytest.raises(DriverError, match=sentence) as refused:
        read_roadtext(path, "7")
    assert len(str(refused.value)) < 400


documents = st.recursive(
    st.none() | st.integers() | st.text(max_size=4),
    lambda inside: (
        st.lists(inside, max_size=4) | st.dictionaries(st.text(max_size=3), inside, max_size=4)
    ),
    max_leaves=12,
)


@given(documents, st.data())
def test_a_part_of_a_document_is_found_on_its_line(document: Any, data: st.DataObject) -> None:
    keys: list[str | int] = []
    part = document
    while part and isinstance(part, list | dict) and data.draw(st.booleans()):
        every: list[Any] = list(part) if isinstance(part, dict) else list(range(len(part)))
        keys.append(data.draw(st.sampled_from(every)))
        part = part[keys[-1]]
    text = json.dumps(document, indent=1)

    line = text.split("\n")[line_of(text, keys) - 1]

    assert line.rstrip(",").endswith(json.dumps(part, indent=1).split("\n")[0])


def test_a_file_that_is_gone_meanwhile_is_still_named(tmp_path: Path) -> None:
    place = Place(tmp_path / "t.json") / "7" / 2

    assert str(place).endswith("t.json: 7[2]")


def test_a_drawn_street_written_as_roadtext_is_read_back_as_it_was(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    from drivers.scenes import RoadScene

    street = RoadScene(size_px=(320, 180), seed=4, weather="clear")
    video, labels = write_roadtext(street, tmp_path, "street", frames=3)

    source = RoadTextVideo(path=str(video), labels=str(labels))

    assert source.length == 3
    for index in range(3):
        wrote, read = street.truth(index), source.truth(index)
        assert read.labels == wrote.labels
        assert read.boxes == pytest.approx(wrote.boxes, abs=1e-3)
        apart = np.abs(source.picture(index).astype(int) - street.picture(index)).mean()
        assert apart < 12
    source.close()


def test_truth_of_more_frames_than_the_video_has_is_refused(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "7.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48)
    )
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    path = written(tmp_path / "t.json", json.dumps({"7": {"9": {"labels": [LABEL]}}}))

    with pytest.raises(DriverError, match="7: expected frames up to 3, got frame 9"):
        RoadTextVideo(path=str(tmp_path / "7.mp4"), labels=str(path))


@pytest.mark.footage
def test_real_photographs_of_icdar_are_read(footage: Footage) -> None:
    folder = footage.data("icdar15")
    source = PannedPictures(path=str(folder), frames_each=2)

    labels = [label for index in range(1, 40, 2) for label in source.truth(index).labels]

    assert source.size_px == (1280, 720)
    assert sum(label != ILLEGIBLE for label in labels) > 20
    assert labels_beside(next(iter(sorted(folder.glob("*.jpg"))))) is not None
