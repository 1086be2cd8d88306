"""Messages -> a Rerun recording that can be read back."""

import socket
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import psutil
import pytest
from rerun.chunk import Chunk, RrdReader

from operators.visualise import Visualise, VisualiseSettings, jpeg, latencies
from pipeline import (
    Detections,
    Frame,
    Header,
    Message,
    MessageError,
    Percept,
    RoiSchedule,
    RunError,
    Scanpath,
    SettingsError,
    Span,
    Tracks,
)
from pipeline.testing import drive, header, picture

BOX = np.array([[100, 100, 140, 160]], np.float32)
ONE = np.ones(1, np.int32)
HALF = np.full(1, 0.5, np.float32)


def traced(seq: int, stage: str) -> Header:
    """Return a header that passed capture and one more stage."""
    told = header(seq)
    ready = told.stamp_ns
    spans = [
        Span(
            stage=name,
            received_ns=ready + 2_000_000 * k,
            done_ns=ready + 2_000_000 * k + 1_500_000,
            handler_ns=1_000_000,
            scheduling_delay_ns=100_000,
        )
        for k, name in enumerate(("capture", stage))
    ]
    return replace(told, trace=tuple(spans))


def exposure(seq: int) -> list[dict[str, Message]]:
    """Return one message for every input."""
    frame = Frame(header=traced(seq, "capture"), pixels=picture(27, 48, seed=seq))
    tracks = Tracks(
        header=traced(seq, "association"),
        ids=ONE,
        labels=ONE,
        scores=HALF,
        boxes=np.repeat(BOX[:, None] + seq, 4, axis=1),
        visible=np.ones((1, 4), np.bool_),
        features=np.zeros((1, 4, 0), np.float32),
        predicted=np.repeat(BOX[:, None] + seq, 16, axis=1),
        names=("ball", "player"),
    )
    told = header(seq)
    return [
        {"context": replace(frame, window=(0, 0, 1920, 1080))},
        {"roi": replace(frame, window=(96, 54, 144, 81))},
        {"detections": Detections(header=told, boxes=BOX, angles=HALF, scores=HALF, labels=ONE,
                                  features=np.zeros((1, 0), np.float32), names=("ball", "player"))},
        {"tracks": tracks},
        {"scanpath": Scanpath(header=told, ids=ONE, probability=np.ones((2, 1), np.float32),
                              choice=np.ones(2, np.int32), boxes=np.repeat(BOX, 2, 0),
                              first_seq=seq + 1)},
        {"schedule": RoiSchedule(header=told, first_seq=seq + 1, windows=BOX.astype(np.int32))},
        {"percept": Percept(header=told, boxes=BOX, ids=ONE, scores=HALF, texts=("EXIT",),
                            action=np.zeros(3, np.float32))},
    ]  # fmt: skip


def recorded(tmp_path: Path, frames: range, **values: object) -> list[Chunk]:
    path = tmp_path / "seen.rrd"
    messages = [message for seq in frames for message in exposure(seq)]
    answers = drive(Visualise, messages, {"save": str(path), **values})
    assert answers == [None] * len(messages)
    return list(RrdReader(path).stream())


def rows(chunks: list[Chunk], path: str, column: str) -> list[object]:
    """Return all that was logged under a path, in the columns whose names end with `column`."""
    found = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == path:
            for name in batch.schema.names:
                if name.endswith(column):
                    found += batch.column(name).to_pylist()
    return found


def test_every_message_is_recorded(tmp_path):
    chunks = recorded(tmp_path, range(3))

    paths = {chunk.entity_path for chunk in chunks}
    assert paths >= {
        "/sensor/context",
        "/sensor/roi",
        "/sensor/roi_window",
        "/sensor/detections",
        "/sensor/tracks",
        "/sensor/tracks/trails",
        "/sensor/tracks/foreseen",
        "/sensor/scanpath",
        "/sensor/scanpath/way",
        "/sensor/schedule",
        "/sensor/percept",
        "/texts",
        "/action",
        "/latency/association/handler_ms",
        "/latency/association/hop_ms",
        "/latency/association/age_ms",
    }


def test_the_box_of_a_lost_object_is_removed(tmp_path):
    path = tmp_path / "seen.rrd"
    none = np.zeros(0, np.float32)
    seen = Percept(header=header(0), boxes=BOX, ids=ONE, scores=HALF)
    lost = Percept(header=header(1), boxes=BOX[:0], ids=ONE[:0], scores=none)

    drive(Visualise, [{"percept": seen}, {"percept": lost}], {"save": str(path)})

    boxes = rows(list(RrdReader(path).stream()), "/sensor/percept", "Boxes2D:half_sizes")
    assert [len(b) for b in boxes] == [1, 0]


def test_times_are_those_of_the_frames(tmp_path):
    chunks = recorded(tmp_path, range(3))

    timelines = {n for c in chunks if c.entity_path == "/sensor/tracks" for n in c.timeline_names}
    assert timelines == {"frame", "stamp"}
    assert sorted(rows(chunks, "/sensor/detections", "frame")) == [0, 1, 2]


def test_boxes_and_names_can_be_read_back(tmp_path):
    chunks = recorded(tmp_path, range(1))

    assert rows(chunks, "/sensor/tracks", "labels") == [["player #1"]]
    assert rows(chunks, "/sensor/tracks", "centers") == [[[120, 130]]]
    assert rows(chunks, "/latency/association/age_ms", "scalars") == [[3.5]]


def test_the_roi_is_placed_where_the_sensor_read_it(tmp_path):
    chunks = recorded(tmp_path, range(1))

    assert rows(chunks, "/sensor/roi", "translation") == [[[96, 54, 0]]]
    assert rows(chunks, "/sensor/roi", "scale") == [[[1, 1, 1]]]
    assert rows(chunks, "/sensor/context", "scale") == [[[40, 40, 1]]]


def test_only_each_nth_frame_is_shown(tmp_path):
    chunks = recorded(tmp_path, range(6), every=3)

    assert sorted(rows(chunks, "/sensor/context", "frame")) == [0, 0, 3, 3]  # place and picture


def test_a_trail_ends_with_its_track(tmp_path):
    subject = Visualise(VisualiseSettings(save=str(tmp_path / "seen.rrd"), every=1000))
    subject.open()

    for seq in range(100):
        tracks = exposure(seq)[3]["tracks"]
        subject.on_tracks(replace(tracks, ids=np.array([seq // 50], np.int32)))

    assert {i: len(trail) for i, trail in subject._trails.items()} == {1: 30}
    subject.close()


def test_the_panels_come_with_the_recording(tmp_path):
    recorded(tmp_path, range(1))

    assert len(RrdReader(tmp_path / "seen.rrd").blueprints()) >= 1


@pytest.mark.parametrize(
    "pixel_format",
    ["rgb8", "bgr8", "grey8", "grey12", "bayer_rggb8", "bayer_bggr10", "bayer_rggb16"],
)
def test_every_pixel_format_becomes_a_picture_of_its_colour(pixel_format):
    colour = picture(16, 16, seed=1) * 0 + np.array([200, 100, 50], np.uint8)
    mosaic = np.empty((16, 16), np.uint8)
    mosaic[::2, ::2], mosaic[1::2, 1::2], mosaic[::2, 1::2], mosaic[1::2, ::2] = 200, 50, 100, 100
    pixels, expected = {
        "rgb8": (colour, [200, 100, 50]),
        "bgr8": (np.full_like(colour, [50, 100, 200]), [200, 100, 50]),
        "grey12": (np.full((16, 16), 90 << 4, np.uint16), [90, 90, 90]),
        "bayer_bggr10": (np.roll(mosaic, (1, 1), (0, 1)).astype(np.uint16) << 2, [200, 100, 50]),
        "grey8": (np.full((16, 16), 90, np.uint8), [90, 90, 90]),
        "bayer_rggb8": (mosaic, [200, 100, 50]),
        "bayer_rggb16": (mosaic.astype(np.uint16) << 8, [200, 100, 50]),
    }[pixel_format]

    contents = jpeg(Frame(header=header(), pixels=pixels, pixel_format=pixel_format), 95)

    seen = cv2.imdecode(np.frombuffer(contents, np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_allclose(seen[4:-4, 4:-4].mean((0, 1)), expected, atol=4)


def test_packed_bytes_are_refused_rather_than_shown_as_a_picture():
    packed = Frame(
        header=header(), pixels=np.zeros((8, 12), np.uint8), pixel_format="bayer_rggb12p"
    )

    with pytest.raises(MessageError, match=r"got bayer_rggb12p; put operators\.downsample before"):
        jpeg(packed, 80)


def test_an_unknown_pixel_format_is_refused():
    with pytest.raises(MessageError, match="got yuv"):
        jpeg(Frame(header=header(), pixels=np.zeros((8, 8), np.uint8), pixel_format="yuv"), 80)


def test_latencies_need_a_trace_and_ages_need_a_common_clock():
    assert latencies(header()) == {}
    assert "capture/age_ms" not in latencies(replace(traced(0, "capture"), clock="edge-box"))


def test_a_destination_is_required():
    with pytest.raises(SettingsError, match="expected save, connect or serve, got none"):
        drive(Visualise, [])


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(RunError, match=r"expected a folder .*/nowhere, got none"):
        drive(Visualise, [], {"save": str(tmp_path / "nowhere" / "seen.rrd")})


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_server_listens_on_the_loopback_only_and_ends_with_the_operator(tmp_path):
    subject = Visualise(VisualiseSettings(serve=True, port=free_port(), web_port=free_port()))

    subject.open()
    server = psutil.Process(subject._server.pid)
    listening = {c.laddr.ip for c in server.net_connections() if c.status == "LISTEN"}
    subject.on_context(**exposure(0)[0])
    subject.close()

    assert listening == {"127.0.0.1"}
    assert not server.is_running()


def test_a_port_that_is_taken_is_named():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]

        with pytest.raises(RunError, match=f"expected port {port} to be free"):
            drive(Visualise, [], {"serve": True, "port": port})
