"""Tables of an examination for a terminal; what operators state is not interpreted."""

from collections.abc import Iterable, Iterator, Sequence

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from pipeline.planner.cpu_plan import CpuPlan, CpuRow
from pipeline.planner.delay_plan import DelayPlan
from pipeline.planner.host_plan import HostRow
from pipeline.planner.link_plan import LinkPlan
from pipeline.planner.links import LINKS
from pipeline.planner.machine import Machine
from pipeline.planner.planner import Examination
from pipeline.planner.pool_plan import PoolPlan, mega
from pipeline.run.memory_folder import MEMORY
from pipeline.terminal import brief, lean_table
from pipeline.text import harmless

UNKNOWN = "not known"
COLOUR = {"fits": "green", "marginal": "yellow", "does not fit": "red"}


def tables(found: Examination, graph: str) -> list[RenderableType]:
    """Return all tables, and lines between them; `graph` is the file, for commands in them."""
    parts: list[RenderableType] = [_streams(found), *_said(found.notes), *_said(_hint(found))]
    for link in found.links:
        parts += [Text(), _link(link), *_said(_crossing(link))]
    if found.hosts:
        parts += [Text(), _hosts(found.hosts)]
    parts += [Text(), _pools(found.pools), *_said(_pool_lines(found.pools, found.machine))]
    for delay in found.delays:
        parts += [Text(), _delay(delay), *_said(_delay_lines(delay, recorded=bool(found.cpu)))]
    if found.cpu is None:
        parts += [Text(), *_said([f"CPU: no profile: {recipe(graph)}"])]
    else:
        parts += [Text(), _cpu(found.cpu), *_said(_cpu_lines(found.cpu, found))]
    return parts


def recipe(graph: str) -> str:
    """Return how a profile is recorded and used."""
    return (
        f"run `fovea run {graph} --duration-s 30 --report profile.json` to record one, then "
        f"`fovea check {graph} --profile profile.json`, both with these options"
    )


def _streams(found: Examination) -> Table:
    table = lean_table(
        "streams", names=("output", "size px", "format"), figures=("MB/frame", "Hz", "MB/s"),
        spare=("MB/frame", "Hz", "format"),
    )  # fmt: skip
    for row in found.streams:
        size = "x".join(map(str, row.size_px)) if row.size_px else UNKNOWN
        _add(
            table, row.output, size, row.pixel_format or "–", _mega(row.frame_bytes),
            f"{row.rate_hz:.4g}" if row.rate_hz else "–", _mega(row.bytes_per_s),
        )  # fmt: skip
    return table


def _hint(found: Examination) -> Iterator[str]:
    if not found.asked and any(row.made and row.bytes_per_s is None for row in found.streams):
        yield "with --ask the sensor is opened, and tells what is not known"


def _link(found: LinkPlan) -> Table:
    what = "link" if found.crosses else "links, if these streams crossed one"
    table = lean_table(
        f"{found.node}: {what}", names=("link",), words=("verdict",),
        figures=("needs MB/s", "carries MB/s", "at best"), spare=("at best", "needs MB/s"),
    )  # fmt: skip
    needs = _mega(found.needed_bytes_per_s)
    if found.stated_bytes_per_s:
        own = UNKNOWN
        if found.needed_bytes_per_s is not None:
            own = "fits" if found.needed_bytes_per_s <= found.stated_bytes_per_s else "does not fit"
        _add(table, "the device's own", _judged(own), needs, mega(found.stated_bytes_per_s), "–")
    for key, link in LINKS.items():
        name = f"{link.name} (in use)" if key == found.kind else link.name
        limits = mega(link.carries_bytes_per_s), mega(link.most_bytes_per_s)
        _add(table, name, _judged(found.verdicts[key]), needs, *limits)
    return table


def _crossing(found: LinkPlan) -> Iterator[str]:
    yield found.streams


def _hosts(found: Sequence[HostRow]) -> Table:
    table = lean_table(
        "pictures between hosts", names=("from", "to"), words=("over GigE",),
        figures=("MB/s", "inputs"), spare=("inputs",),
    )  # fmt: skip
    for row in found:
        needs, count = mega(row.bytes_per_s), str(len(row.edges))
        _add(table, row.source, row.target, _judged(row.gige), needs, count)
    return table


def _pools(found: PoolPlan) -> Table:
    several = any(row.host for row in found.rows)
    table = lean_table(
        "frame pools", names=("output", *(["host"] if several else [])),
        figures=("slots", "MB", "from"), spare=("from", "slots"),
    )  # fmt: skip
    for row in found.rows:
        origin = "profile" if row.recorded else "settings" if row.pool_bytes is not None else "–"
        _add(
            table, row.output, *([row.host] if several else []), str(row.slots),
            _mega(row.pool_bytes), origin,
        )  # fmt: skip
    return table


def _pool_lines(found: PoolPlan, machine: Machine) -> Iterator[str]:
    unknown = sum(row.pool_bytes is None for row in found.rows) + found.others
    least = "at least " if unknown else ""
    line = f"in all {least}{mega(found.total_bytes)} MB"
    if not found.compared:
        line += ", on several hosts: not compared with their memory"
    elif machine.shared_bytes:
        shared = f"{mega(machine.shared_free_bytes)} of {mega(machine.shared_bytes)} MB"
        memory = f"{mega(machine.memory_free_bytes)} of {mega(machine.memory_bytes)} MB"
        line += f"; {shared} free in {MEMORY}, {memory} of memory"
    yield line
    if unknown:
        yield f"without {unknown} {'output' if unknown == 1 else 'outputs'} that no setting tells"


def _delay(found: DelayPlan) -> Table:
    table = lean_table(
        f"{found.node}: delay", names=("of",), figures=("ms", "frames", "frames with a plan"),
        spare=("ms",),
    )  # fmt: skip
    for row in found.rows:
        share = UNKNOWN if row.coverage is None else f"{row.coverage:.0%}"
        frames = "–" if row.frames is None else str(row.frames)
        _add(table, row.of, "–" if row.ms is None else brief(row.ms), frames, share)
    return table


def _delay_lines(found: DelayPlan, *, recorded: bool) -> Iterator[str]:
    horizon, directed = found.horizon_frames, found.directed_frames
    if horizon and directed:
        each = f"a new one every Ta = {found.replan_frames}"
        if found.burst_frames:
            each += f", bursts of {found.burst_frames}"
        yield (
            f"plans reach Tp = {horizon} frames, {each}: every frame has one up to "
            f"{max(0, horizon - directed)} frames of delay"
        )
    else:
        yield "how far plans reach is not known"
    if not recorded:
        yield "what the loop adds is not known without a profile"


def _cpu(found: CpuPlan) -> Table:
    at = f" at {found.rate_hz:.4g} Hz" if found.rate_hz else ""
    grouped = any(row.nodes != (row.process,) for row in found.rows)
    shared = any(row.shares for row in found.rows)
    words = [f"nodes{', share of handler time' * shared}"] if grouped else []
    table = lean_table(f"CPU{at}", names=("process",), words=words, figures=("ms/frame", "cores"))
    for row in found.rows:
        cores = "–" if row.cores is None else f"{row.cores:.2f}"
        _add(
            table, row.process, *([_nodes(row)] if grouped else []),
            brief(row.ms_per_frame), cores,
        )  # fmt: skip
    return table


def _nodes(row: CpuRow) -> str:
    if not row.shares:
        return ", ".join(row.nodes)
    shares = zip(row.nodes, row.shares, strict=True)
    return ", ".join(f"{node} {100 * share:.0f} %" for node, share in shares)


def _cpu_lines(found: CpuPlan, whole: Examination) -> Iterator[str]:
    if found.cores is not None:
        here = f"of {whole.machine.cores:g} cores" if whole.pools.compared else "cores on all hosts"
        yield f"in all {found.cores:.2f} {here}, recorded over {found.recorded}"
    else:
        yield f"no rate to hold; recorded over {found.recorded}"
    if found.changed:
        yield f"recorded with other settings of {', '.join(found.changed)}"
    if found.missing:
        yield f"not in the profile: {', '.join(found.missing)}"


def _judged(verdict: str) -> Text:
    return Text(verdict, style=COLOUR.get(verdict, ""))


def _mega(nbytes: float | None) -> str:
    return "–" if nbytes is None else mega(nbytes)


def _said(lines: Iterable[str]) -> list[RenderableType]:
    return [Text(harmless(line, 400)) for line in lines]


def _add(table: Table, *cells: str | Text) -> None:
    """Add cells without markup: names and formats may be anything."""
    table.add_row(*(Text(harmless(c)) if isinstance(c, str) else c for c in cells))
