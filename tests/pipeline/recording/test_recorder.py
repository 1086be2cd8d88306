"""A recording holds every message bit for bit, and can be read whenever its writer ends."""

import errno
import resource
import signal
import subprocess
import sys
import tempfile
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap")

import lz4.frame
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from pipeline import Frame, Message, Percept, RunError
from pipeline.messages import Detections
from pipeline.pixel_formats import FORMATS
from pipeline.recording.mcap_file import Item, McapChunks, McapWriter
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Limits, Recorder
from pipeline.run.played import differing
from pipeline.testing import header

ENDLESS = """
import itertools, sys, time
from pathlib import Path
import numpy as np
from pipeline import Frame
from pipeline.recording.recorder import Limits, Recorder
from pipeline.testing import header
recorder = Recorder(Path(sys.argv[1]), Limits(chunk_s=0.1))
for seq in itertools.count():
    pixels = np.full((90, 160, 3), seq % 256, np.uint8)
    recorder.add("capture.context", Frame(header=header(seq), pixels=pixels), wait=True)
    print(seq, time.time(), flush=True)
    time.sleep(0.005)
"""


def frame(seq: int, side_px: int = 16, stream: str = "test") -> Frame:
    noise = np.random.default_rng(seq).integers(0, 256, (side_px, side_px, 3), np.uint8)
    return Frame(header=header(seq, stream=stream), pixels=noise, window=(0, 0, 1920, 1080))


def percept(seq: int) -> Percept:
    boxes = np.full((1, 4), seq, np.float32)
    return Percept(
        header=header(seq), boxes=boxes, ids=np.zeros(1, np.int32), scores=np.ones(1, np.float32)
    )


def recorded(path: Path, messages: list[tuple[str, Message]], **limits: float) -> Recorder:
    recorder = Recorder(path, Limits(**limits))  # type: ignore[arg-type]
    for output, message in messages:
        recorder.add(output, message, wait=True)
    assert recorder.close() == ""
    return recorder


def decoded(item: Item) -> Any:
    """Return a protobuf message, decoded by the schema in the file alone."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(item.topic.schema).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(item.topic.schema_name))
    return kind.FromString(item.data)


def seqs(path: Path, output: str = "capture.context") -> list[int]:
    return [seq for _stream, seq in Recording(path).messages.get(output, {})]


@pytest.mark.parametrize("form", sorted(FORMATS))
def test_pixels_of_every_format_come_back_bit_for_bit(form: str, tmp_path: Path) -> None:
    shape = FORMATS[form].shape((24, 10))
    pixels = np.random.default_rng(1).integers(0, 256, shape).astype(FORMATS[form].dtype)
    sent = Frame(header=header(3), pixels=pixels, pixel_format=form, window=(0, 0, 24, 10))

    recorded(tmp_path / "a.mcap", [("capture.roi", sent)])
    found = Recording(tmp_path / "a.mcap").message("capture.roi", Frame, ("test", 3))

    assert found is not None
    assert list(differing(sent, found)) == []


def test_a_picture_is_decoded_by_the_schema_in_the_file_alone(tmp_path: Path) -> None:
    sent = frame(3, side_px=24)
    recorded(tmp_path / "a.mcap", [("capture.roi", sent)])

    chunks = McapChunks(tmp_path / "a.mcap").scan()
    image = next(i for _, items in chunks for i in items if i.topic.name == "/capture/roi/image")
    found = decoded(image)

    assert image.topic.schema_name == "foxglove.RawImage"
    assert (found.width, found.height, found.step, found.encoding) == (24, 24, 72, "rgb8")
    assert found.data == sent.pixels.tobytes()
    assert found.timestamp.ToNanoseconds() == sent.header.stamp_ns


def test_boxes_are_drawn_on_the_first_picture_of_the_whole_field(tmp_path: Path) -> None:
    whole = header(3).geometry
    context = replace(frame(3), window=(0, 0, whole.width_px, whole.height_px))
    half = (whole.width_px / 2, whole.height_px / 2)
    seen = replace(percept(3), boxes=np.array([[0, 0, *half]], np.float32), texts=("EXIT",))
    none = replace(percept(4), boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32),
                   scores=np.zeros(0, np.float32))  # fmt: skip

    recorded(
        tmp_path / "a.mcap", [("capture.context", context), ("reader", seen), ("reader", none)]
    )

    items = [i for _, found in McapChunks(tmp_path / "a.mcap").scan() for i in found]
    drawn = [decoded(i) for i in items if i.topic.name == "/reader/boxes"]
    corners = [(point.x, point.y) for point in drawn[0].points[0].points]
    assert corners == [(0, 0), (8, 0), (8, 8), (0, 8)]  # of a picture of 16 x 16
    assert [text.text for text in drawn[0].texts] == ["EXIT"]
    assert drawn[0].points[0].timestamp.ToNanoseconds() == context.header.stamp_ns
    assert len(drawn[1].points) == 0
    assert Recording(tmp_path / "a.mcap").newest("boxes") == {"picture": "/capture/context/image"}


@given(n=st.integers(0, 5), channels=st.integers(0, 3), word=st.text(max_size=20))
@settings(max_examples=20, deadline=None)
def test_other_messages_come_back_bit_for_bit(n: int, channels: int, word: str) -> None:
    random = np.random.default_rng(n)
    sent = Detections(
        header=header(9), boxes=random.random((n, 4), np.float32),
        angles=np.full(n, np.nan, np.float32), scores=random.random(n, np.float32),
        labels=np.arange(n, dtype=np.int32), features=random.random((n, channels), np.float32),
        names=(word,),
    )  # fmt: skip

    with tempfile.TemporaryDirectory() as folder:
        recorded(Path(folder) / "a.mcap", [("saliency.out", sent)])
        found = Recording(Path(folder) / "a.mcap").message("saliency.out", Detections, ("test", 9))

    assert found is not None
    assert list(differing(sent, found)) == []


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_every_compression_is_read_back(compression: str, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(compression=compression))
    recorder.add("capture.context", frame(4))
    assert recorder.close() == ""

    found = Recording(tmp_path / "a.mcap").message("capture.context", Frame, ("test", 4))

    assert found is not None
    assert list(differing(frame(4), found)) == []


def test_a_picture_is_found_when_a_chunk_ends_before_its_message(tmp_path: Path) -> None:
    sent = [frame(seq) for seq in range(5)]

    recorded(tmp_path / "a.mcap", [("capture.roi", one) for one in sent], chunk_bytes=1)
    recording = Recording(tmp_path / "a.mcap")

    for one in sent:
        found = recording.message("capture.roi", Frame, ("test", one.header.seq))
        assert found is not None
        assert list(differing(one, found)) == []


def test_a_killed_recorder_leaves_a_file_that_ends_less_than_a_second_before(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, path], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    sent = [child.stdout.readline().split() for _ in range(100)]
    child.send_signal(signal.SIGKILL)
    sent += [line.split() for line in child.stdout.read().splitlines()]
    child.stdout.close()
    child.wait()

    recording = Recording(path)
    found = [seq for _stream, seq in recording.messages["capture.context"]]

    assert found == list(range(len(found)))
    at_s = {int(seq): float(at) for seq, at in (line for line in sent if len(line) == 2)}
    assert max(at_s.values()) - at_s[found[-1]] < 1.0
    assert recording.message("capture.context", Frame, ("test", found[-1])) is not None


@given(keep=st.floats(0, 1))
@settings(max_examples=25, deadline=None)
def test_of_a_truncated_file_the_whole_chunks_are_read(keep: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        recorded(path, [("capture.context", frame(k)) for k in range(20)], chunk_bytes=2000)
        whole = path.read_bytes()
        path.write_bytes(whole[: int(len(whole) * keep)])

        try:
            found = seqs(path)
        except RunError as error:
            assert "expected" in str(error)  # noqa: PT017 - both outcomes are right
        else:
            assert found == list(range(len(found)))
            assert len(found) >= 20 * keep - 4


@given(place=st.integers(8, 9000), value=st.integers(0, 255))
@settings(max_examples=40, deadline=None)
def test_a_damaged_file_gives_valid_messages_or_one_sentence(place: int, value: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        recorded(path, [("capture.context", frame(k)) for k in range(20)], chunk_bytes=2000)
        data = bytearray(path.read_bytes())
        data[place % len(data)] = value
        path.write_bytes(data)

        try:
            found = seqs(path)
        except RunError as error:
            assert str(path) in str(error)  # noqa: PT017 - both outcomes are right
        else:
            assert found == sorted(found)


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"RIFF" * 100)

    with pytest.raises(RunError, match="expected an MCAP file, got something else"):
        Recording(tmp_path / "a.mcap")


PACKED = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("size", [10, 40_000_000, 1 << 40])
@pytest.mark.parametrize("compression", PACKED)
def test_a_chunk_that_grows_without_measure_ends_the_file(
    tmp_path: Path, compression: str, size: int
) -> None:
    chunk = Chunk(
        compression=compression, data=PACKED[compression](bytes(40_000_000)), uncompressed_crc=0,
        message_start_time=0, message_end_time=0, uncompressed_size=size,
    )  # fmt: skip
    path = tmp_path / "a.mcap"
    recorded(path, [("capture.context", frame(seq)) for seq in range(3)])
    whole = path.read_bytes()
    builder = RecordBuilder()
    chunk.write(builder)
    path.write_bytes(whole[:8] + builder.end() + whole[8:])
    chunks, begun_s = McapChunks(path), time.thread_time()  # whatever else the machine does
    tracemalloc.start()

    found = list(chunks.scan())

    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == []
    assert f"is damaged at byte 8 of {path.stat().st_size}, " in chunks.broken
    assert time.thread_time() - begun_s < 20
    assert most_bytes < 200_000_000


def test_what_was_written_before_the_disk_was_full_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, Limits(chunk_bytes=2000))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))  # stands for a full disk
    try:
        for seq in range(100):
            recorder.add("capture.context", frame(seq), wait=True)
        failure = recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    assert "File too large" in failure
    found = seqs(path)
    assert found == list(range(len(found)))
    assert len(found) > 10
    figures = recorder.figures()["capture.context"]
    assert (figures["recorded"], figures["dropped"]) == (len(found), 100 - len(found))


def test_what_was_in_the_chunk_in_progress_when_the_disk_was_full_is_not_recorded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    add, added = McapWriter.add, []

    def full_at_ten(self: McapWriter, item: Item) -> None:
        added.append(item)
        if len(added) == 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        add(self, item)

    monkeypatch.setattr(McapWriter, "add", full_at_ten)
    recorder = Recorder(tmp_path / "a.mcap", Limits(chunk_s=1000))
    for seq in range(20):
        recorder.add("capture.context", frame(seq), wait=True)

    assert "No space left on device" in recorder.close()
    figures = recorder.figures()["capture.context"]
    assert (figures["recorded"], figures["dropped"]) == (0, 20)


def test_what_an_earlier_file_holds_is_recorded_though_the_disk_is_full_later(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    add, full = McapWriter.add, []

    def full_in_the_second(self: McapWriter, item: Item) -> None:
        if self.path.stem.endswith("-2") and item.topic.name.startswith("/capture"):
            full.append(item)
            raise OSError(errno.ENOSPC, "No space left on device")
        add(self, item)

    monkeypatch.setattr(McapWriter, "add", full_in_the_second)
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, Limits(chunk_bytes=2000, file_bytes=20_000))
    for seq in range(100):
        recorder.add("capture.context", frame(seq), wait=True)

    assert "No space left on device" in recorder.close()
    assert full
    figures = recorder.figures()["capture.context"]
    found = len(seqs(path))
    assert (figures["recorded"], figures["dropped"]) == (found, 100 - found)


def test_gaps_and_drops_are_counted_in_the_file(tmp_path: Path) -> None:
    sent = [("capture.context", frame(seq)) for seq in (0, 1, 4, 5)]

    recorded(tmp_path / "a.mcap", [*sent, ("capture.context", frame(0, stream="next"))])

    end = Recording(tmp_path / "a.mcap").newest("end")
    counts = end["accounts"]["capture.context"]
    assert counts == {"recorded": 5, "dropped": 0, "passed": 0, "gaps": 2, "refused": 0}


def test_a_full_queue_drops_and_counts(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(queue_bytes=1 << 20))

    for seq in range(40):
        recorder.add("capture.context", frame(seq, side_px=500))  # faster than they are written
    recorder.close()

    counts = recorder.figures()["capture.context"]
    assert counts["dropped"] > 0
    assert counts["recorded"] + counts["dropped"] == 40
    assert len(seqs(tmp_path / "a.mcap")) == counts["recorded"]


def test_a_new_file_begins_at_a_size_and_loses_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(file_bytes=10_000, chunk_bytes=1000))
    recorder.note("graph", {"name": "a graph"})
    for seq in range(40):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.close()

    assert len(recorder.files) > 2
    assert [seq for path in recorder.files for seq in seqs(path)] == list(range(40))
    assert all(Recording(path).newest("graph")["name"] == "a graph" for path in recorder.files)


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("mine")

    recorder = recorded(tmp_path / "a.mcap", [("capture.context", frame(0))])

    assert (tmp_path / "a.mcap").read_text() == "mine"
    assert recorder.files == [tmp_path / "a-2.mcap"]
