"""Plan a graph: what its streams need of link, memory, time and cores, and whether they get it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.contract import outputs_of
from pipeline.forecast import Forecast
from pipeline.graph.plan import Plan, load_operator, sources
from pipeline.messages import Frame
from pipeline.planner import cpu_plan, delay_plan, link_plan, pool_plan
from pipeline.planner.cpu_plan import CpuPlan
from pipeline.planner.delay_plan import DelayPlan, Measured
from pipeline.planner.forecasts import forecasts
from pipeline.planner.host_plan import HostRow, host_rows
from pipeline.planner.link_plan import LinkPlan
from pipeline.planner.machine import Machine
from pipeline.planner.pool_plan import PoolPlan
from pipeline.run.recorded_run import RecordedRun, digest


@dataclass(frozen=True, kw_only=True)
class StreamRow:
    """The pictures of one output; None and 0 are not known."""

    output: str  # node or node.output
    made: bool  # by a source
    size_px: tuple[int, int] | None
    pixel_format: str
    frame_bytes: int | None
    rate_hz: float
    bytes_per_s: float | None


@dataclass(frozen=True, kw_only=True)
class Examination:
    """Every figure of a plan, and what follows: refusals cannot work, warnings may not."""

    streams: tuple[StreamRow, ...]
    links: tuple[LinkPlan, ...]
    hosts: tuple[HostRow, ...]
    pools: PoolPlan
    delays: tuple[DelayPlan, ...]
    cpu: CpuPlan | None  # None: there is no profile
    machine: Machine
    asked: bool  # whether the sensor was
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    refusals: tuple[str, ...]


def examine(
    plan: Plan, settings: Mapping[str, Any], machine: Machine, *,
    run: RecordedRun | None = None, link: str = "", ask: bool = False,
) -> Examination:  # fmt: skip
    """Plan a graph with its built settings by node; raises `FoveaError` for what has no figures.

    `run` is a recorded one, `link` a key of `LINKS` that the streams have to fit; with `ask` the
    sensor is opened and asked.
    """
    told = forecasts(plan, settings, ask=ask)
    made = [node.name for node in sources(plan)]
    by_source = {name: link_plan.link_plan(name, told[name], link) for name in made}
    links = [found for found in by_source.values() if found is not None]
    unsure = (s for name, found in by_source.items() for s in link_plan.unknown(name, found, link))
    profile = run.profile if run else None
    pools = pool_plan.pool_plan(plan, told, profile.pools if profile else None)
    delays = tuple(delay_plan.delay_plans(plan, told, measured(plan, made, run)))
    cpu = cpu_plan.cpu_plan(plan, run, rate_of(told, made)) if run else None
    judged = None if plan.hosts else cpu  # the cores of other hosts are not known here
    return Examination(
        streams=tuple(stream_rows(plan, told, made)),
        links=tuple(links),
        hosts=host_rows(plan, told),
        pools=pools,
        delays=delays,
        cpu=cpu,
        machine=machine,
        asked=ask,
        notes=tuple(f"{name}: {found.note}" for name, found in told.items() if found.note),
        warnings=(*unsure, *_warnings(links, pools, delays, judged, machine)),
        refusals=tuple(_refusals(links, pools, delays, judged, machine)),
    )


def _refusals(
    links: Sequence[LinkPlan], pools: PoolPlan, delays: Sequence[DelayPlan], cpu: CpuPlan | None,
    machine: Machine,
) -> Iterator[str]:  # fmt: skip
    for link in links:
        yield from link_plan.refused(link)
    yield from pool_plan.refused(pools, machine)
    for delay in delays:
        yield from delay_plan.refused(delay)
    if cpu is not None:
        yield from cpu_plan.refused(cpu, machine)


def _warnings(
    links: Sequence[LinkPlan], pools: PoolPlan, delays: Sequence[DelayPlan], cpu: CpuPlan | None,
    machine: Machine,
) -> Iterator[str]:  # fmt: skip
    for link in links:
        yield from link_plan.doubted(link)
    yield from pool_plan.doubted(pools, machine)
    for delay in delays:
        if not any(delay_plan.refused(delay)):
            yield from delay_plan.doubted(delay)
    if cpu is not None:
        yield from cpu_plan.doubted(cpu, machine)


def stream_rows(plan: Plan, told: Mapping[str, Forecast], made: Sequence[str]) -> list[StreamRow]:
    """Return every output of pictures, known or not."""
    rows = []
    for node in plan.nodes:
        for output, message in outputs_of(load_operator(node.operator)).items():
            stream = told[node.name].streams.get(output)
            if stream is None and (message is not Frame or not plan.readers(node.name, output)):
                continue  # such as further windows of a sensor that reads one
            rows.append(
                StreamRow(
                    output=node.name if output == "out" else f"{node.name}.{output}",
                    made=node.name in made,
                    size_px=stream.size_px if stream else None,
                    pixel_format=stream.pixel_format if stream else "",
                    frame_bytes=stream.frame_bytes if stream else None,
                    rate_hz=stream.rate_hz if stream else 0.0,
                    bytes_per_s=stream.bytes_per_s if stream else None,
                )
            )
    return rows


def rate_of(told: Mapping[str, Forecast], made: list[str]) -> float:
    """Return the highest rate of frames that a source sends; 0: not known."""
    rates = [stream.rate_hz for name in made for stream in told[name].streams.values()]
    return max([*rates, *(told[name].rate_hz for name in made if not any(rates))], default=0.0)


def measured(plan: Plan, made: list[str], run: RecordedRun | None) -> Measured | None:
    """Return the loop of a recorded run; None where no command was measured."""
    if run is None or run.profile is None or not (run.loop and run.loop.commands and run.rate):
        return None
    recorded = run.profile.settings
    spread = run.loop.latency_ms
    return Measured(
        latency_ms={"p50": spread.p50, "p99": spread.p99},
        rate_hz=run.rate.asked_hz or run.rate.achieved_hz,
        same_sensor=all(recorded.get(name) == digest(plan.node(name)) for name in made),
    )
