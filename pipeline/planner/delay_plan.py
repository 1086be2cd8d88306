"""Frames of delay against plans: sensor and recorded loop in, share of frames with a plan out.

A plan made from frame j speaks of j+1 … j+Tp and is replaced Ta frames later. With a delay of d
frames, d + Ta > Tp leaves frames undirected, and from d = Tp on no plan ever directs a frame. Of a
sensor that records bursts of N frames along a plan, those count alone: N takes the place of Ta.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from pipeline.forecast import Forecast, coverage
from pipeline.graph.plan import Plan

SLACK = 1e-9  # of rounded quotients


@dataclass(frozen=True, kw_only=True)
class DelayRow:
    """One figure of the delay."""

    of: str  # sensor | loop p50 | loop p99
    frames: int | None  # None: not known
    ms: float | None  # None: it is not measured
    coverage: float | None  # share of frames with a plan; None: how far plans reach is not known


@dataclass(frozen=True, kw_only=True)
class DelayPlan:
    """The loop of one source."""

    node: str  # that sends the commands
    horizon_frames: int  # Tp; 0: not known
    replan_frames: int  # Ta; 0: not known
    burst_frames: int = 0  # recorded along a plan; 0: every frame is live
    rate_hz: float  # in which frames are counted; 0: not known
    rows: tuple[DelayRow, ...]

    @property
    def directed_frames(self) -> int:
        """Frames that every plan has to direct; 0: not known."""
        return min(self.burst_frames or self.replan_frames, self.replan_frames)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The loop's latency in a recorded run, from the picture being ready to the command."""

    latency_ms: Mapping[str, float]  # p50, p99
    rate_hz: float
    same_sensor: bool  # with the same settings; another one's read-out is not in the latency


def delay_plans(
    plan: Plan, told: Mapping[str, Forecast], measured: Measured | None = None
) -> Iterator[DelayPlan]:
    """Yield the delay of every loop. In lockstep the sensor's own delay is all there is."""
    for edge in plan.edges:
        if not edge.command:
            continue
        sensor, commands = told[edge.target], told[edge.source]
        rate_hz = sensor.rate_hz or (measured.rate_hz if measured else 0.0)
        own = sensor.readout_frames if sensor.lead_frames else None
        waits: list[tuple[str, float | None, float | None]] = [("sensor", None, own)]
        if measured is not None and rate_hz and plan.clock == "realtime":
            besides = 0.0 if measured.same_sensor else sensor.readout_frames
            for name, ms in measured.latency_ms.items():
                waits.append((f"loop {name}", ms, besides + ms / 1000 * rate_hz))
        found = DelayPlan(
            node=edge.source,
            horizon_frames=commands.horizon_frames,
            replan_frames=commands.replan_frames,
            burst_frames=sensor.burst_frames,
            rate_hz=rate_hz,
            rows=(),
        )
        rows = (
            _row(of, ms, None if wait is None else late(wait, sensor.lead_frames), found)
            for of, ms, wait in waits
        )
        yield replace(found, rows=tuple(rows))


def late(wait_frames: float, lead_frames: int) -> int:
    """Return the frames that go by undirected after the one that a command was made from.

    The command arrives `wait_frames` after that frame and directs the next one to be exposed;
    `lead_frames` is the sensor's own least distance, 0 where it is not known.

    >>> late(0.4, 1), late(1.2, 1), late(28.7, 1), late(0.4, 3)
    (0, 1, 28, 2)
    """
    return max(1, lead_frames, math.ceil(wait_frames - SLACK)) - 1


def refused(found: DelayPlan) -> Iterator[str]:
    """Yield a sentence where the usual plan arrives after the last frame that it speaks of."""
    for row in reversed(found.rows):
        usual = row.frames if row.of != "loop p99" else None
        if usual is not None and 0 < found.horizon_frames <= usual:
            yield (
                f"{found.node}: delay: expected plans of more than {row.frames} frames, which is "
                f"the delay ({_told(row)}), got {found.horizon_frames}: every plan arrives too late"
            )
            return


def doubted(found: DelayPlan) -> Iterator[str]:
    """Yield a sentence where frames are left without a plan: of the largest delay that does."""
    for row in reversed(found.rows):
        if row.coverage is not None and row.coverage < 1:
            spare = max(0, found.horizon_frames - found.directed_frames)
            each = "for a burst of" if found.burst_frames else "a new one every"
            yield (
                f"{found.node}: delay: {row.frames} frames ({_told(row)}), and plans of "
                f"{found.horizon_frames} frames, {each} {found.directed_frames}, allow "
                f"{spare}: {row.coverage:.0%} of the frames have a plan"
            )
            return


def _row(of: str, ms: float | None, frames: int | None, found: DelayPlan) -> DelayRow:
    horizon, directed = found.horizon_frames, found.directed_frames
    known = frames is not None and horizon and directed
    share = coverage(frames or 0, directed, horizon) if known else None
    return DelayRow(of=of, frames=frames, ms=ms, coverage=share)


def _told(row: DelayRow) -> str:
    return f"{row.of} {row.ms:.0f} ms" if row.ms is not None else "of the sensor alone"
