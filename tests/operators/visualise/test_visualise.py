"""Messages -> a Rerun recording that can be read back."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import Chunk, RrdReader

from operators.visualise import Visualise, VisualiseSettings, jpeg, latencies
from operators.visualise.pictures import jpeg_within
from operators.visualise.visualise import MOST_FULL_PX
from pipeline import Frame, MessageError, Percept, RunError, SettingsError
from pipeline.commands import carry_out
from pipeline.errors import InstallError
from pipeline.testing import drive, header, picture
from tests.operators.visualise.exposures import BOX, HALF, ONE, exposure, part, traced


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
                    values = batch.column(name)
                    found += (values.cast("int64") if name == "time" else values).to_pylist()
    return found


def layout_of(path: Path) -> dict[str, set[str]]:
    """Return the names of all layouts' views, their collapsed panels and their timeline."""
    reader = RrdReader(path)
    chunks = [c for layout in reader.blueprints() for c in reader.stream(store=layout)]
    panels = [c.entity_path for c in chunks if rows([c], c.entity_path, "Blueprint:state") == [[2]]]
    names = [rows([c], c.entity_path, "ViewBlueprint:display_name") for c in chunks]
    return {
        "views": {name for found in names for (name,) in found},
        "collapsed": set(panels),
        "timeline": {name for (name,) in rows(chunks, "/time_panel", "timeline")},
    }


FIELD = {
    "/sensor/context", "/sensor/roi", "/sensor/roi_rim", "/sensor/tracks", "/sensor/target",
    "/sensor/tracks/predicted", "/sensor/planned", "/sensor/planned/numbers", "/sensor/truth",
    "/sensor/percept", "/window/roi", "/full",
}  # fmt: skip
FIGURES = {
    "/latency/loop/p50", "/latency/loop/p99", "/latency/loop/budget_p50",
    "/latency/loop/budget_p99", "/latency/stages/capture",
    "/latency/stages/dispatch", "/figures/pixels/read", "/figures/pixels/budget",
    "/figures/target/in_roi", "/figures/target/iou", "/action", "/figures/action_change",
    "/latency/stack/areas", "/latency/stack/names", "/latency/stack/budget",
    "/latency/stack/scale",
    "/scanpath/raster", "/scanpath/names", "/scanpath/now", "/log", "/legend",
}  # fmt: skip
DETAILS = {
    "/sensor/detections", "/sensor/tracks/trails", "/objects/1/score", "/objects/1/probability",
    "/latency/each/association/handler_ms", "/latency/each/association/age_ms",
}  # fmt: skip


def test_the_entity_paths_are_those_of_the_documentation(tmp_path):
    paths = {chunk.entity_path for chunk in recorded(tmp_path, range(5))}

    readme = Path("operators/visualise/README.md").read_text()
    assert paths - {"/__properties"} == FIELD | FIGURES
    examples = ("/latency/stages/", "/latency/each/", "/objects/")  # with NODE or ID there
    named = {path for path in FIELD | FIGURES | DETAILS if not path.startswith(examples)}
    assert {path for path in named if f"`{path[1:]}`" not in readme} == set()


def test_series_of_each_stage_and_object_are_drawn_on_request_only(tmp_path):
    paths = {chunk.entity_path for chunk in recorded(tmp_path, range(2), details=True)}

    assert paths >= DETAILS


def test_only_the_target_has_its_name_on_the_field(tmp_path):
    chunks = recorded(tmp_path, range(3))

    assert rows(chunks, "/sensor/target", "Boxes2D:labels")[-1] == ["player #1"]
    assert rows(chunks, "/sensor/target", "show_labels")[-1] == [True]
    assert rows(chunks, "/sensor/tracks", "Boxes2D:labels")[-1] == [
        "ball #2"
    ]  # for whoever points at it
    assert {shown for row in rows(chunks, "/sensor/tracks", "show_labels") for shown in row} == {
        False
    }


def test_the_truth_is_dashed(tmp_path):
    chunks = recorded(tmp_path, range(1))

    (strips,) = rows(chunks, "/sensor/truth", "strips")
    assert len(strips) == 2 * 4 * 3
    assert strips[0] == [[100, 100], [108, 100]]


def test_the_view_opens_on_frames_with_its_panels_collapsed(tmp_path):
    recorded(tmp_path, range(2))

    layout = layout_of(tmp_path / "seen.rrd")
    assert layout["timeline"] == {"frame"}
    assert layout["collapsed"] == {"/selection_panel", "/blueprint_panel", "/time_panel"}
    assert layout["views"] >= {
        "whole field, the ROI in place", "ROI, as read", "the same window in the context",
        "policy: objects by frames", "loop latency, ms", "by stage, ms", "action change",
        "pixels", "drops", "texts and events", "what is drawn", "action",
    }  # fmt: skip


def test_what_the_consumer_does_has_a_place_only_where_it_does_it(tmp_path):
    for kind, changed in (
        ("plain", {"texts": (), "action": np.zeros(0, np.float32)}),
        ("acts", {"texts": ()}),
        ("reads", {"action": np.zeros(0, np.float32)}),
    ):
        answer = replace(part(0, "percept"), **changed)
        given = [{"percept": answer}, *({"roi": part(seq, "roi")} for seq in range(2))]
        drive(Visualise, given, {"save": str(tmp_path / f"{kind}.rrd")})

    views = {kind: layout_of(tmp_path / f"{kind}.rrd")["views"] for kind in ("acts", "reads")}
    plain = layout_of(tmp_path / "plain.rrd")["views"]

    assert not {"action", "details", "texts and events"} & plain
    assert views["acts"] - plain == {"action", "action change"}
    assert views["reads"] - plain == {"texts and events"}


def test_of_a_long_action_the_first_values_are_plotted(tmp_path):
    answer = replace(part(0, "percept"), action=np.arange(1400, dtype=np.float32))
    drive(Visualise, [{"percept": answer}], {"save": str(tmp_path / "seen.rrd")})

    chunks = list(RrdReader(tmp_path / "seen.rrd").stream())

    assert rows(chunks, "/action", "Scalars:scalars") == [[0, 1, 2, 3, 4, 5, 6, 7]]


def test_the_legend_begins_with_the_figures_of_now(tmp_path):
    chunks = recorded(tmp_path, range(60))

    texts = [text for (text,) in rows(chunks, "/legend", "TextDocument:text")]

    assert len(texts) == 2  # one a second
    assert texts[0].startswith("**Target**: none")
    now = texts[-1].splitlines()[0]
    assert now.startswith("**Target**: player #1, ")
    assert "in the ROI, IoU " in now
    assert "of the pixels. **Loop**: " in now
    assert "**Bright yellow**" in texts[-1]


def test_what_is_read_lies_beside_full_resolution_where_that_is_known(tmp_path):
    recorded(tmp_path, range(2))
    both = layout_of(tmp_path / "seen.rrd")["views"]
    parts = [{name: part(0, name)} for name in ("context", "roi")]
    drive(Visualise, parts, {"save": str(tmp_path / "plain.rrd")})

    plain = layout_of(tmp_path / "plain.rrd")["views"]

    assert both >= {"what is read", "full resolution"}
    assert ("what is read" in plain, "full resolution" in plain) == (True, False)


def test_a_very_large_full_picture_is_averaged():
    tall = Frame(header=header(0), pixels=picture(2, 3 * MOST_FULL_PX, seed=0))

    contents, size_px = jpeg_within(tall, 80, MOST_FULL_PX)

    shown = cv2.imdecode(np.frombuffer(contents, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert (size_px, shown.shape) == ((MOST_FULL_PX, 1), (1, MOST_FULL_PX, 3))


def test_figures_say_what_the_roi_shows_of_the_target(tmp_path):
    chunks = recorded(tmp_path, range(3))

    read = rows(chunks, "/figures/pixels/read", "scalars")
    assert read[0] == [pytest.approx(100 * 2 * 27 * 48 / (1920 * 1080))]
    assert rows(chunks, "/figures/pixels/budget", "scalars")[0] == [
        pytest.approx(100 * (27 * 48 + 480 * 270) / (1920 * 1080))
    ]
    assert rows(chunks, "/figures/target/iou", "scalars")[-1][0] == pytest.approx(2204 / 2596)


def test_the_log_tells_of_another_instance_and_of_missing_frames(tmp_path):
    path = tmp_path / "seen.rrd"
    seen = [part(seq, "tracks") for seq in (0, 1, 2, 5, 31)]
    seen[3:] = [replace(m, header=replace(m.header, epoch=2)) for m in seen[3:]]

    drive(Visualise, [{"tracks": m} for m in seen], {"save": str(path)})

    told = [line for (line,) in rows(list(RrdReader(path).stream()), "/log", "TextLog:text")]
    assert told == [
        "the sensor was opened: stream test",
        "association: instance 2 took over (a restart or a swap)",
        "association: 27 frames did not arrive here, 27 in all",
    ]


def test_a_command_adds_lines_and_drops(tmp_path):
    path = tmp_path / "seen.rrd"
    subject = Visualise(VisualiseSettings(save=str(path)))
    subject.open()
    subject.on_context(part(0, "context"))

    told = {"lines": ['policy.target = "ball"'], "drops": {"a.b to c.d/superseded": 3}}
    carry_out("viewer_1", subject, "note", told)
    subject.close()

    chunks = list(RrdReader(path).stream())
    assert rows(chunks, "/log", "TextLog:text") == [['policy.target = "ball"']]
    counts = {c.entity_path: rows(chunks, c.entity_path, "scalars") for c in chunks}
    assert [v for k, v in counts.items() if k.startswith("/drops/")] == [[[3]]]


def test_the_box_of_a_lost_object_is_removed(tmp_path):
    path = tmp_path / "seen.rrd"
    none = np.zeros(0, np.float32)
    seen = Percept(header=header(0), boxes=BOX, ids=ONE, scores=HALF)
    lost = Percept(header=header(1), boxes=BOX[:0], ids=ONE[:0], scores=none)

    drive(Visualise, [{"percept": seen}, {"percept": lost}], {"save": str(path)})

    boxes = rows(list(RrdReader(path).stream()), "/sensor/percept", "Boxes2D:half_sizes")
    assert [len(b) for b in boxes] == [1, 0]


def test_a_text_is_drawn_where_something_is_tracked_only(tmp_path):
    path = tmp_path / "seen.rrd"
    elsewhere = BOX + 40
    both = np.concatenate([BOX, elsewhere])
    told = {"ids": np.arange(2, dtype=np.int32), "scores": np.ones(2, np.float32)}
    read = Percept(header=header(0), boxes=both, texts=("HERE", "GONE"), **told)

    drive(Visualise, [{"tracks": part(0, "tracks")}, {"percept": read}], {"save": str(path)})

    chunks = list(RrdReader(path).stream())
    assert rows(chunks, "/sensor/percept", "Boxes2D:labels") == [["HERE"]]


def test_times_count_from_the_start_of_the_stream(tmp_path):
    chunks = recorded(tmp_path, range(5, 8))

    timelines = {n for c in chunks if c.entity_path == "/sensor/tracks" for n in c.timeline_names}
    assert timelines == {"frame", "time"}
    assert sorted(rows(chunks, "/sensor/tracks", "frame")) == [5, 6, 7]
    assert sorted(rows(chunks, "/sensor/tracks", "time")) == [0, 33_333_333, 66_666_666]


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
        tracks = part(seq, "tracks")
        subject.on_tracks(replace(tracks, ids=np.array([seq // 50, 9], np.int32)))

    assert {i: len(trail) for i, trail in subject._trails.items()} == {1: 30, 9: 30}
    subject.close()


def test_the_same_window_of_the_context_is_drawn_as_large_as_the_roi(tmp_path):
    chunks = recorded(tmp_path, range(2))

    (blob, *_more) = rows(chunks, "/window/roi", "blob")
    seen = cv2.imdecode(np.frombuffer(bytes(blob[0]), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert seen.shape == (27, 48, 3)


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


def test_without_rerun_the_package_to_install_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)

    with pytest.raises(InstallError, match=r"rerun-sdk, got none: pip install 'fovea\[view\]'"):
        Visualise.advise(VisualiseSettings(), {})


def test_a_destination_is_required():
    with pytest.raises(SettingsError, match="expected save, connect or serve, got none"):
        drive(Visualise, [])


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(RunError, match=r"expected a folder .*/nowhere, got none"):
        drive(Visualise, [], {"save": str(tmp_path / "nowhere" / "seen.rrd")})
