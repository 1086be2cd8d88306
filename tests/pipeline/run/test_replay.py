"""A replay computes what was recorded, bit for bit, and names the first difference."""

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from rerun.chunk import RrdReader

from operators.visualise.beside import MOST_COLUMNS, columns
from pipeline import GraphError, Message, RunError
from pipeline.class_cache import adapter
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.graph.shipped import graph_path, source_path
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Recorder
from pipeline.run.inline import InlineRunner
from pipeline.run.replay import plan_in, record_inline, replay
from tests.commands import command
from tests.sample_graphs import LOOP, plan_of
from tests.shared_data import Footage

TRACKING = """\
nodes:
  capture:
    operator: operators.capture:Capture
    inputs: {schedule: dispatch}
    settings: {options: {scene: soccer, size_px: [640, 360], rate_hz: 30, seed: SEED}}
  saliency:
    operator: operators.saliency:Saliency
    inputs: {frame: capture.context}
  association:
    operator: operators.association:Association
    inputs: {detections: saliency}
  policy:
    operator: operators.policy:PursuitPolicy
    inputs: {tracks: association}
    settings: {target: ball}
  dispatch:
    operator: operators.dispatch:Dispatch
    inputs: {scanpath: policy}
  motion:
    operator: operators.examples.motion:Motion
    inputs: {frame: capture.context}
"""


VIEWER = """\
  visualise:
    operator: operators.visualise:Visualise
    manual: true
    inputs: {context: capture.context, roi: capture.roi, tracks: association}
"""


def recording_of(plan: Plan, tmp_path: Path, frames: int) -> Recording:
    record_inline(plan, tmp_path / "a.mcap", frames, lambda: 0)
    return Recording(tmp_path / "a.mcap")


@pytest.mark.parametrize("seed", [1, 2])
def test_a_replay_computes_what_was_recorded_bit_for_bit(seed: int, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, TRACKING.replace("SEED", str(seed)), clock="lockstep")
    recording = recording_of(plan, tmp_path, 6)

    found = replay(plan_in(recording), recording, verify=True)

    assert (found.frames, found.different, found.first) == (6, 0, None)
    assert found.compared >= 5 * 6


def test_the_first_difference_is_named_by_output_frame_and_field(tmp_path: Path) -> None:
    text = TRACKING.replace("SEED", "1")
    recording = recording_of(plan_of(tmp_path, text, clock="lockstep"), tmp_path, 6)
    other = plan_of(tmp_path, text, clock="lockstep", changes=("association.observed=3",))

    found = replay(other, recording, verify=True)

    assert found.different > 0
    assert str(found.first).startswith("association.out: frame 0: ")


def test_any_node_can_be_replaced(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep")
    recording = recording_of(plan, tmp_path, 10)

    found = replay(plan, recording, nodes=("work", "pair"), verify=True)

    assert (found.frames, found.compared, found.different) == (10, 10, 0)  # only `steer` ran


def test_frames_of_two_streams_with_one_number_are_two_frames(tmp_path: Path) -> None:
    plan, path = plan_of(tmp_path, LOOP, clock="lockstep"), tmp_path / "a.mcap"
    recorder = Recorder(path)
    for _ in range(2):  # as where a source begins anew
        with InlineRunner(plan, watch=lambda o, m: recorder.add(o, m, wait=True)) as runner:
            list(runner.run(3))
    recorder.close()
    recording, times_ns = Recording(path), list[int]()

    def step(_seq: int, log_ns: int) -> bool:
        times_ns.append(log_ns)
        return True

    found = replay(plan, recording, step=step)

    assert times_ns == list(recording.exposures.values())
    assert found.frames == 6
    assert found.recorded_s == (times_ns[-1] - times_ns[0]) / 1e9


def test_an_output_that_was_not_recorded_is_named(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep")
    recording = recording_of(plan, tmp_path, 2)
    del recording.messages["ticker.roi"]

    with pytest.raises(GraphError, match=r"pair\.right reads ticker\.roi: expected it in the"):
        replay(plan, recording)


def test_an_unknown_node_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep")

    with pytest.raises(GraphError, match="no node worker, did you mean 'work'"):
        replay(plan, recording_of(plan, tmp_path, 2), nodes=("worker",))


def test_the_command_prints_the_difference_and_has_its_exit_status(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep")
    graph, file = str(tmp_path / "graph.yaml"), str(tmp_path / "a.mcap")

    made = command("record", graph, "--inline", "--frames", "5", "--out", file)
    same = command("replay", file, "--verify")
    other = command("replay", file, graph, "--set", "ticker.side_px=32", "--verify")
    again = command("record", graph, "--inline", "--frames", "5", "--out", file)

    assert "ticker.context: 5 messages" in made.stdout
    assert (same.returncode, "equal bit for bit" in same.stdout) == (0, True)
    assert (other.returncode, "equal bit for bit" in other.stdout) == (
        0,
        True,
    )  # no pixels are made
    assert (again.returncode, again.stderr) == (
        2, f"fovea: --out {file}: expected a new file, got one that exists\n",
    )  # fmt: skip
    assert plan.name in same.stdout


def partly(tmp_path: Path, held: Callable[[str, int], bool]) -> Path:
    """Return a recording of six frames of the loop with the messages that are held."""
    plan, path = plan_of(tmp_path, LOOP, clock="lockstep"), tmp_path / "a.mcap"
    recorder = Recorder(path)

    def watch(output: str, message: Message) -> None:
        if held(output, message.header.seq):
            recorder.add(output, message, wait=True)

    recorder.note("graph", {"plan": adapter(Plan).dump_python(plan, mode="json")})
    with InlineRunner(plan, watch=watch) as runner:
        list(runner.run(6))
    recorder.close()
    return path


def test_computed_outputs_that_were_not_recorded_are_told(tmp_path: Path) -> None:
    path = partly(tmp_path, lambda output, _seq: output not in ("work.out", "steer.out"))

    found = command("replay", str(path), "--verify")

    assert (found.returncode, found.stdout.splitlines()[1:]) == (0, [
        "verified: 6 messages, equal bit for bit",
        "not recorded, and so not compared: steer.out, work.out",
    ])  # fmt: skip


def test_a_recording_of_the_source_alone_is_not_verified(tmp_path: Path) -> None:
    path = partly(tmp_path, lambda output, _seq: output.startswith("ticker."))

    found = command("replay", str(path), "--verify")

    assert (found.returncode, found.stdout, found.stderr) == (2, "", (
        f"fovea: {path}: cannot be verified: expected an output that is computed (pair.out, "
        "steer.out, work.out), got ticker.context, ticker.roi\n"
    ))  # fmt: skip
    assert command("replay", str(path)).returncode == 0


def test_a_replay_that_computes_nothing_is_not_verified(tmp_path: Path) -> None:
    recording = Recording(partly(tmp_path, lambda _output, _seq: True))

    with pytest.raises(GraphError, match="expected a node that computes an output, got the rec"):
        replay(plan_in(recording), recording, nodes=("work", "pair", "steer"), verify=True)


FIRST_LACKING = {"ticker": "work.out", "pair": "pair.out"}


def ragged(output: str, seq: int) -> bool:
    """Whether a recorder has a message that joined and left between the outputs of an exposure."""
    first, last = {"ticker.context": (1, 5), "ticker.roi": (1, 4)}.get(output, (0, 5))
    return first <= seq <= last


def test_exposures_at_the_ends_that_were_recorded_in_part_are_left_out(tmp_path: Path) -> None:
    path = partly(tmp_path, ragged)

    found = command("replay", str(path), "--verify")

    assert (found.returncode, found.stdout.splitlines()[1:]) == (0, [
        "verified: 12 messages, equal bit for bit",
        "left out: 6 messages; the file begins or ends in the middle of their exposures",
    ])  # fmt: skip


@pytest.mark.parametrize(
    ("lacking", "what"),
    [("ticker", "recorded, and not computed again"), ("pair", "computed, and not recorded")],
)
def test_a_gap_between_the_ends_is_a_difference(lacking: str, what: str, tmp_path: Path) -> None:
    path = partly(tmp_path, lambda output, seq: not (seq == 2 and output.startswith(lacking)))
    recording = Recording(path)

    found = replay(plan_in(recording), recording, verify=True)

    assert str(found.first) == f"{FIRST_LACKING[lacking]}: frame 2: message: {what}"
    assert found.outside == 0


def test_a_run_that_was_recorded_as_a_whole_is_compared_to_its_ends(tmp_path: Path) -> None:
    recording = recording_of(plan_of(tmp_path, LOOP, clock="lockstep"), tmp_path, 6)
    recording.messages["pair.out"].popitem()

    found = replay(plan_in(recording), recording, verify=True)

    assert str(found.first) == "pair.out: frame 5: message: computed, and not recorded"
    assert (found.different, found.outside) == (1, 0)


def test_a_recording_whose_outputs_share_no_exposure_is_not_verified(tmp_path: Path) -> None:
    path = partly(tmp_path, lambda output, seq: (seq < 3) == output.startswith("ticker."))

    found = command("replay", str(path), "--verify")

    said = f"fovea: {path}: cannot be verified: expected a message to compare, got none\n"
    assert (found.returncode, found.stderr) == (1, said)


def test_runs_on_the_same_light_are_compared_in_a_table(tmp_path: Path) -> None:
    full = "size_px: [640, 360], rate_hz: 30, seed: 1, strategy: full"
    text = TRACKING.replace("size_px: [640, 360], rate_hz: 30, seed: SEED", full) + VIEWER
    plan_of(tmp_path, text)
    graph, file = str(tmp_path / "graph.yaml"), str(tmp_path / "a.mcap")
    command("record", graph, "--inline", "--frames", "3", "--out", file)

    tries = ("--try", "capture.roi_area=0.0625", "--try", "capture.roi_area=0.04")
    saved = str(tmp_path / "both.rrd")
    found = command("replay", file, graph, "--light", *tries, "--save", saved)

    assert found.returncode == 0, found.stderr
    lines = found.stdout.splitlines()
    assert lines[:2] == [f"{k}: {one}" for k, one in enumerate(tries[1::2], 1)]
    (used,) = (line.split()[1:] for line in lines if line.startswith("pixels.used"))
    assert float(used[0]) > float(used[1])
    chunks = list(RrdReader(saved).stream())
    pictures = [{c.entity_path for c in chunks if c.entity_path.startswith(f"/try_{k}/")}
                for k in (1, 2)]  # fmt: skip
    assert all(f"/try_{k}/sensor/roi" in paths for k, paths in enumerate(pictures, 1))
    (layout,) = RrdReader(saved).blueprints()
    shown = " ".join(c.format() for c in RrdReader(saved).stream(store=layout))
    assert all(name in shown for name in tries[1::2])


def test_too_many_runs_side_by_side_are_refused(tmp_path: Path) -> None:
    names = tuple(f"capture.seed={k}" for k in range(MOST_COLUMNS + 1))

    with pytest.raises(RunError, match="expected 1 to 4 runs side by side, got 5"):
        columns(names)


@pytest.mark.footage
def test_a_run_on_footage_is_replayed_bit_for_bit(footage: Footage, tmp_path: Path) -> None:
    folder = footage.data("soccernet/SNMOT-116a")
    over = Overlay(
        source=source_path("soccernet"), changes=(f"capture.path={folder}",), clock="lockstep"
    )
    recording = recording_of(load(graph_path("tracking"), over), tmp_path, 30)

    found = replay(plan_in(recording), recording, verify=True)

    assert (found.frames, found.different, found.first) == (30, 0, None)
    assert found.compared >= 6 * 30
