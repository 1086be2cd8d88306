"""The reader on drawn texts, with the real PP-OCR."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("rapidocr")

from operators.reader import OnnxReader, Reader
from operators.reader.ctc import OnnxReaderSettings, decoded
from operators.reader.ocr import LONGEST_SIDE_PX, PaddleOcr, provider_of, starts
from operators.reader.reader import ReaderSettings
from pipeline import Frame, Header, Percept, SettingsError, Tracks
from pipeline.errors import MessageError, WeightsError
from pipeline.messages import Geometry

FIELD = Geometry(width_px=1280, height_px=720, roi_width_px=320, roi_height_px=180)


def header(seq: int = 0) -> Header:
    return Header(stream="s", seq=seq, stamp_ns=seq, geometry=FIELD)


def picture(text: str = "BAKERY", at: tuple[int, int] = (60, 90)) -> NDArray[np.uint8]:
    drawn = np.full((180, 320, 3), (30, 60, 120), np.uint8)
    cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 1.0, (250, 250, 250), 2, cv2.LINE_AA)
    return drawn


def roi(pixels: NDArray[np.uint8], seq: int = 0, left: int = 400, top: int = 300) -> Frame:
    window = (left, top, left + 320, top + 180)
    return Frame(header=header(seq), pixels=pixels, window=window)


def context(seq: int = 0) -> Frame:
    return Frame(
        header=header(seq), pixels=np.zeros((180, 320, 3), np.uint8), window=(0, 0, 1280, 720)
    )


def tracks(*boxes: tuple[float, float, float, float], seq: int = 0) -> Tracks:
    count = len(boxes)
    row = np.array(boxes, np.float32).reshape(count, 1, 4)
    return Tracks(
        header=header(seq),
        ids=np.arange(count, dtype=np.int32),
        labels=np.zeros(count, np.int32),
        scores=np.ones(count, np.float32),
        boxes=row,
        visible=np.ones((count, 1), bool),
        features=np.zeros((count, 1, 4), np.float32),
        predicted=row,
        names=("text",),
    )


@pytest.fixture(scope="module")
def reader() -> Reader:
    made = Reader(ReaderSettings())
    made.open()
    return made


@pytest.fixture(autouse=True)
def fresh(reader: Reader) -> None:
    reader.on_stream(header())


def test_a_text_in_the_roi_is_read_and_placed_on_the_sensor(reader: Reader) -> None:
    percept = reader.on_context_roi(context(), roi(picture()))

    assert percept.texts == ("BAKERY",)
    assert percept.scores[0] > 0.9
    assert percept.boxes[0] == pytest.approx([460, 368, 585, 392], abs=10)


def test_a_text_stays_known_when_the_roi_looks_elsewhere(reader: Reader) -> None:
    first = reader.on_context_roi(context(), roi(picture()))

    later = reader.on_context_roi(context(1), roi(picture("HOTEL"), 1, left=0, top=0))

    assert set(later.texts) == {"BAKERY", "HOTEL"}
    assert later.ids[later.texts.index("BAKERY")] == first.ids[0]


def test_what_computes_the_networks_is_what_their_sessions_use(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    ocr = reader._ocr
    recogniser = SimpleNamespace(get_providers=lambda: ["CUDAExecutionProvider", "none"])

    assert reader.runs_on() == "cpu"
    monkeypatch.setattr(ocr._engine.text_rec.session, "session", recogniser)
    assert provider_of(ocr._engine) == "cpu, cuda"


def test_without_a_roi_nothing_is_read_unless_the_context_is_asked_for() -> None:
    other = Reader(ReaderSettings(reads="context"))
    other.open()
    empty = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))
    whole = Frame(header=header(), pixels=picture(), window=(0, 0, 1280, 720))

    percept = other.on_context_roi(whole, empty)

    assert percept.texts == ("BAKERY",)
    assert percept.boxes[0] == pytest.approx([240, 272, 740, 368], abs=40)


def test_without_a_picture_the_answer_is_empty(reader: Reader) -> None:
    empty = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))

    percept = reader.on_context_roi(context(), empty)

    assert percept.texts == ()
    assert percept.boxes.shape == (0, 4)


def test_small_text_is_not_enlarged_to_be_read() -> None:
    small = np.full((180, 320, 3), (30, 60, 120), np.uint8)
    small[50:72, 50:90] = cv2.resize(picture(), (40, 22), interpolation=cv2.INTER_AREA)

    assert "BAKERY" not in [each.text for each in PaddleOcr()(small)]


def test_a_text_in_a_picture_too_large_for_one_reading_is_found_where_it_is() -> None:
    large = np.full((700, 2 * LONGEST_SIDE_PX, 3), 40, np.uint8)
    left = LONGEST_SIDE_PX + 700
    large[400:580, left : left + 320] = picture()

    found = PaddleOcr()(large)

    assert [each.text for each in found] == ["BAKERY"]
    assert left < found[0].box[0] < left + 100
    assert len(starts(2 * LONGEST_SIDE_PX)) == 3


def test_a_successor_knows_what_was_read(reader: Reader) -> None:
    first = reader.on_context_roi(context(), roi(picture()))
    successor = OnnxReader(OnnxReaderSettings())
    successor.open()

    successor.restore(reader.state())
    percept = successor.on_context_roi(context(1), roi(picture("HOTEL"), 1))

    assert percept.texts == ("BAKERY",)
    assert percept.ids.tolist() == first.ids.tolist()


def test_the_second_reader_reads_where_tracks_are() -> None:
    second = OnnxReader(OnnxReaderSettings())
    second.open()
    second.on_tracks(tracks((455, 362, 592, 396), (700, 400, 760, 420)))

    percept = second.on_context_roi(context(), roi(picture()))

    assert percept.texts == ("BAKERY",)


def test_the_second_reader_reads_where_tracks_of_an_earlier_frame_foresee_a_text() -> None:
    second = OnnxReader(OnnxReaderSettings())
    second.open()
    before = tracks((155, 362, 292, 396))
    second.on_tracks(replace(before, predicted=before.boxes + np.float32([300, 0, 300, 0])))

    percept = second.on_context_roi(context(1), roi(picture(), 1))

    assert percept.texts == ("BAKERY",)
    assert percept.boxes[0] == pytest.approx([455, 362, 592, 396], abs=2)


def test_a_text_that_both_pictures_show_is_one_text() -> None:
    both = Reader(ReaderSettings(reads="both"))
    both.open()
    whole = Frame(header=header(), pixels=picture(), window=(0, 0, 1280, 720))
    near = Frame(header=header(), pixels=picture(), window=(0, 0, 1280, 720))

    percepts = [both.on_context_roi(whole, near) for _ in range(2)]

    assert [percept.texts for percept in percepts] == [("BAKERY",)] * 2


def test_the_second_reader_reads_nothing_without_tracks() -> None:
    second = OnnxReader(OnnxReaderSettings())
    second.open()

    percept: Percept = second.on_context_roi(context(), roi(picture()))

    assert percept.texts == ()


def test_raw_pixels_are_refused_with_what_to_put_before(reader: Reader) -> None:
    raw = roi(np.zeros((180, 320), np.uint8))

    with pytest.raises(MessageError, match="Downsample makes them"):
        reader.on_context_roi(context(), raw)


def test_a_missing_network_is_refused_in_a_sentence_before_a_run_too() -> None:
    missing = ReaderSettings(recognition="no.onnx")

    for refused in (Reader(missing).open, lambda: Reader.advise(missing, {})):
        with pytest.raises(WeightsError, match=r"recognition: expected an ONNX file, got no\.onnx"):
            refused()
    with pytest.raises(WeightsError, match=r"weights: expected an ONNX file, got no\.onnx"):
        OnnxReader.advise(OnnxReaderSettings(weights="no.onnx"), {})
    assert not [*Reader.advise(ReaderSettings(), {}), *OnnxReader.advise(OnnxReaderSettings(), {})]


@pytest.mark.parametrize("shift", [0.0, -20.0])  # logits; as logarithms of probabilities, below 0
def test_a_network_that_ends_before_the_softmax_is_as_sure_as_its_probabilities(
    shift: float,
) -> None:
    chances = np.array([[0.1, 0.6, 0.3], [0.8, 0.1, 0.1], [0.2, 0.1, 0.7]], np.float32)

    text, score = decoded(np.log(chances) + 10 + np.float32(shift), ("A", "B"))

    assert (text, score) == ("AB", pytest.approx(0.65, abs=1e-4))
    assert decoded(chances, ("A", "B")) == ("AB", pytest.approx(0.65, abs=1e-6))


def test_a_file_that_is_no_network_is_refused_in_a_sentence(tmp_path: Path) -> None:
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")

    with pytest.raises(WeightsError, match="PP-OCR does not load"):
        Reader(ReaderSettings(detection=str(broken))).open()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"reads": "sky"}, "reads: expected roi, context, both, got 'sky'"),
        ({"least_score": 2.0}, r"least_score: must be within 0\.\.1"),
        ({"forget_after": 0}, "forget_after: must be at least 1"),
    ],
)
def test_settings_out_of_range_are_refused(values: dict[str, object], sentence: str) -> None:
    for settings in (ReaderSettings, OnnxReaderSettings):
        with pytest.raises(SettingsError, match=sentence):
            settings(**values)  # type: ignore[arg-type]
