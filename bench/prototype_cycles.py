"""Record cycles of a board that records bursts: `Cycles`, a node, and what its file says.

A cycle is a plan, the burst that it directs, and the burst's download.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from drivers.source import CLASS_OF_ROLE, FrameSource
from pipeline import Frame, Input, Operator, RoiSchedule, Scanpath, SettingsError
from pipeline.boxes import covered

NODE = """\
nodes:
  cycles:
    operator: bench.prototype_cycles:Cycles
    inputs: {{roi: capture.roi, schedule: dispatch, scanpath: policy}}
    settings: {{path: {path}}}
"""


@dataclass(frozen=True, kw_only=True)
class CyclesSettings:
    """The file that is written."""

    path: str = ""

    def __post_init__(self) -> None:
        if not self.path:
            raise SettingsError("path: expected a file to write, got nothing")


class Cycles(Operator[CyclesSettings, None]):
    """Writes a line of JSON for every exposure and every plan, with the times of their stages."""

    roi = Input(Frame, keep="every")
    schedule = Input(RoiSchedule, keep="every", join=False)
    scanpath = Input(Scanpath, keep="latest", join=False, optional=True)

    _file: IO[str] | None = None

    def open(self) -> None:
        """Open the file."""
        self._file = Path(self.settings.path).open("a", encoding="utf-8")  # noqa: SIM115

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def on_roi(self, roi: Frame) -> None:
        """Write what an exposure showed; a preview shows no region."""
        self._write(
            kind="frame", seq=roi.header.seq, stamp_ns=roi.header.stamp_ns, window=roi.window,
            command_seq=roi.command_seq, status=roi.status, recorded=bool(roi.pixels.size),
            captured_ns=roi.header.trace[-1].done_ns if roi.header.trace else 0,
        )  # fmt: skip

    def on_schedule(self, schedule: RoiSchedule) -> None:
        """Write when a plan was ready."""
        spans = [(s.stage, s.received_ns, s.done_ns, s.handler_ns) for s in schedule.header.trace]
        self._write(
            kind="plan", seq=schedule.header.seq, stamp_ns=schedule.header.stamp_ns,
            first_seq=schedule.first_seq, frames=len(schedule.windows), spans=spans,
        )  # fmt: skip

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Write which object is looked at first, a negative number: a place."""
        chosen = int(scanpath.choice[0]) if len(scanpath.choice) else -1
        self._write(kind="aim", seq=scanpath.header.seq, object=chosen)

    def _write(self, **line: Any) -> None:
        if self._file is not None:
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """One plan and its burst; frames are exposures of the sensor."""

    made_from: int  # newest context of the plan
    first: int  # first exposure that the plan directed
    seqs: tuple[int, ...]  # recorded exposures
    windows: NDArray[np.int32]  # (n, 4)
    planned: int  # windows of the plan
    readout_ms: float  # exposure of that context -> the graph has it
    compute_ms: float  # -> the plan leaves the graph
    stages_ms: Mapping[str, float]  # of that, each stage's own time

    @property
    def delay_frames(self) -> int:
        """Frames from the newest context of the plan to the first that it directs."""
        return self.first - self.made_from


def node_file(path: Path) -> Path:
    """Write the node that fills `path` into a file beside it, to be added to a graph."""
    added = path.with_suffix(".yaml")
    added.write_text(NODE.format(path=json.dumps(str(path))), encoding="utf-8")
    return added


@dataclass(kw_only=True)
class Recording:
    """What the node has written so far. A last line that is not whole is left for later."""

    path: Path
    lines: list[dict[str, Any]] = field(default_factory=list)
    bursts: int = 0  # that were downloaded: a preview came after them
    recording: bool = False  # whether the newest frame is one of a burst
    newest_preview: int = -1  # frame, -1: none yet
    newest_aim: int = -1  # frame whose tracks the policy saw last, -1: none yet
    aimed_at: int = -1  # object that it then chose, -1: none
    _offset: int = 0  # bytes read

    def update(self) -> bool:
        """Read on; return whether something new was there."""
        if not self.path.is_file():
            return False
        with self.path.open("rb") as file:
            file.seek(self._offset)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._offset += len(whole)
        fresh = [json.loads(line) for line in whole.splitlines()]
        for line in fresh:
            self._note(line)
        self.lines += fresh
        return bool(fresh)

    def _note(self, line: Mapping[str, Any]) -> None:
        if line["kind"] == "aim":
            self.newest_aim, self.aimed_at = line["seq"], line["object"]
        elif line["kind"] == "frame":
            self.bursts += self.recording and not line["recorded"]
            self.recording = line["recorded"]
            if not line["recorded"]:
                self.newest_preview = line["seq"]


def cycles_of(lines: Iterable[Mapping[str, Any]]) -> list[Cycle]:
    """Return the cycles whose bursts were downloaded: a preview came after them."""
    plans = {line["seq"]: line for line in lines if line["kind"] == "plan"}
    frames = [line for line in lines if line["kind"] == "frame"]
    contexts = {line["seq"]: line for line in frames}
    previews = [line["seq"] for line in frames if not line["recorded"]]
    found = []
    for made_from, plan in sorted(plans.items()):
        burst = [f for f in frames if f["recorded"] and f["command_seq"] == made_from]
        over = burst and previews and previews[-1] > burst[-1]["seq"]
        if over and made_from in contexts:
            found.append(_cycle(plan, burst, contexts[made_from]))
    return found


def _cycle(
    plan: Mapping[str, Any], burst: Sequence[Mapping[str, Any]], context: Mapping[str, Any]
) -> Cycle:
    captured_ns, done_ns = context["captured_ns"], plan["spans"][-1][2]
    return Cycle(
        made_from=plan["seq"],
        first=burst[0]["seq"],
        seqs=tuple(f["seq"] for f in burst),
        windows=np.array([f["window"] for f in burst], np.int32),
        planned=plan["frames"],
        readout_ms=(captured_ns - context["stamp_ns"]) / 1e6,
        compute_ms=(done_ns - captured_ns) / 1e6,
        stages_ms={stage: own / 1e6 for stage, _, _, own in plan["spans"][1:]},
    )


def shares(cycle: Cycle, world: FrameSource) -> dict[str, float]:
    """Return the mean share of the true boxes inside the ROI over a burst, by class and by object.

    Objects are `class id`; those that are hidden count, as the ROI shows their place.
    """
    sums: dict[str, list[float]] = {}
    for seq, window in zip(cycle.seqs, cycle.windows, strict=True):
        truth = world.truth(seq)
        if truth is None:
            continue
        inside = covered(truth.boxes, window.astype(np.float32))
        for label, own, share in zip(truth.labels, truth.ids, inside, strict=True):
            name = CLASS_OF_ROLE.get(label, label)
            sums.setdefault(f"{name} {own}", []).append(float(share))
            sums.setdefault(name, []).append(float(share))
    return {name: float(np.mean(values)) for name, values in sorted(sums.items())}
