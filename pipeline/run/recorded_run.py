"""Profile of a run, in its report: CPU by process, sizes of the pools, which settings were used.

`fovea run GRAPH --report FILE` records it, `fovea check GRAPH --profile FILE` plans with it.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec

from pipeline.errors import SettingsError
from pipeline.graph.plan import Node, Plan
from pipeline.run.process_handle import Sample
from pipeline.text import said_by
from pipeline.wording import shown

MOST_BYTES = 64 << 20  # of a report
LEAST_SPAN_S = 1.5  # between the first and the last sample of a process
Count = Annotated[int, msgspec.Meta(ge=0)]
Positive = Annotated[float, msgspec.Meta(ge=0)]


class ProcessProfile(msgspec.Struct, frozen=True, kw_only=True):
    """The CPU time of one process."""

    nodes: tuple[str, ...]
    cores: Positive  # CPU seconds per second, from the first exposure on


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """What a run used."""

    cores: Positive  # of the machine, to this run
    processes: dict[str, ProcessProfile]  # without those that were too short to measure
    pools: dict[str, Count]  # bytes of the pool files by `node.output`
    settings: dict[str, str]  # `digest` by node


class RecordedEdge(msgspec.Struct, frozen=True, kw_only=True):
    """What an edge carried."""

    to: str  # node.input
    offered: Count


class RecordedStage(msgspec.Struct, frozen=True, kw_only=True):
    """How many messages, or sets of them, a node handled."""

    node: str
    handled: Count
    latency_ms: "Spread | None" = None  # of its handlers


class RecordedRate(msgspec.Struct, frozen=True, kw_only=True):
    """The rate of the source."""

    frames: Count
    achieved_hz: Positive
    asked_hz: Positive | None = None


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Median and 99th percentile."""

    p50: Positive
    p99: Positive


class RecordedLoop(msgspec.Struct, frozen=True, kw_only=True):
    """The time from a picture being ready to the command made from it."""

    latency_ms: Spread
    commands: Count


class RecordedRun(msgspec.Struct, frozen=True, kw_only=True):
    """The part of a report that a plan needs."""

    graph: str
    clock: str
    duration_s: Positive
    edges: tuple[RecordedEdge, ...]
    stages: tuple[RecordedStage, ...]
    rate: RecordedRate | None = None
    loop: RecordedLoop | None = None
    profile: Profile | None = None


def profile_of(
    plan: Plan, samples: Mapping[str, Sequence[Sample]], pools: Mapping[str, int],
    *, cores: float, since_s: float,
) -> Profile:  # fmt: skip
    """Return the profile of a run that exposed since `since_s`, in monotonic time."""
    used = {name: cores_used(samples.get(name, ()), since_s) for name in plan.processes()}
    return Profile(
        cores=cores,
        processes={
            name: ProcessProfile(nodes=tuple(n.name for n in nodes), cores=round(found, 6))
            for name, nodes in plan.processes().items()
            if (found := used[name]) is not None
        },
        pools=dict(pools),
        settings={node.name: digest(node) for node in plan.nodes},
    )


def cores_used(samples: Sequence[Sample], since_s: float) -> float | None:
    """Return the CPU seconds per second of the newest instance; None without two samples of it."""
    newest = [s for s in samples if s.pid == samples[-1].pid and s.at_s >= since_s]
    if len(newest) < 2 or newest[-1].at_s - newest[0].at_s < LEAST_SPAN_S:
        return None
    return max(0.0, newest[-1].cpu_s - newest[0].cpu_s) / (newest[-1].at_s - newest[0].at_s)


def digest(node: Node) -> str:
    """Return what is equal for the same operator with the same settings."""
    words = json.dumps([node.operator, node.settings], sort_keys=True, default=str)
    return hashlib.sha256(words.encode()).hexdigest()[:16]


def read_profile(path: Path, plan: Plan) -> RecordedRun:
    """Read the report of a run of this graph; raises `SettingsError` in one sentence."""
    where = f"--profile {path}"
    try:
        run = msgspec.json.decode(_bytes_of(path), type=RecordedRun)
    except OSError as error:
        raise SettingsError(f"{where}: cannot be read: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise SettingsError(f"{where}: expected the report of a run: {said_by(error)}") from error
    record = "`fovea run GRAPH --duration-s 30 --report FILE` records one"
    if run.graph != plan.name:
        raise SettingsError(
            f"{where}: expected a run of {plan.name}, got one of {shown(run.graph)}; {record}"
        )
    if run.profile is None or run.clock != "realtime":
        got = "without a profile" if run.profile is None else f"in {shown(run.clock)}"
        raise SettingsError(
            f"{where}: expected a run as processes in real time, got one {got}; {record}"
        )
    if not (run.profile.processes and run.rate and run.rate.frames and run.duration_s):
        raise SettingsError(f"{where}: expected a run of some seconds, got one without figures")
    return run


def _bytes_of(path: Path) -> bytes:
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise SettingsError(f"--profile {path}: expected up to {MOST_BYTES} bytes, got more")
    return data


def as_data(profile: Profile) -> dict[str, Any]:
    """Return the profile for the report."""
    return dict(msgspec.to_builtins(profile))
