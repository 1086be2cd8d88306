"""Reports that benches wrote themselves (`--json`, `--out`): their origin, figures and rows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.bus import CONTESTANTS
from bench.results.figures import figures, rows_of, spread
from bench.results.markdown import cell, lines, table
from bench.results.places import ELSEWHERE, PLACES, Place
from bench.results.table import ResultError

T = TypeVar("T")
LONGEST_INTERVAL = 2
INTERVAL = "_ci95"  # behind the name of a figure
# graphs were renamed in commit 43c4367; reports of these earlier commits name them as they were
BEFORE_RENAMING = frozenset({
    "2f602782", "330d447d", "47a488af", "4f41e6c4", "7f307550", "9b96c832", "ad8546b9", "0f1ec150",
    "e0550d11",
})  # fmt: skip
TODAY = {"tracking": "learned", "broadcast": "tracking"}  # a graph's name then -> today
LABELS = {contestant.module: contestant.label for contestant in CONTESTANTS}


class Machine(msgspec.Struct, frozen=True):
    """Where a report was measured, as `bench.machine.facts` writes it."""

    cpu: str
    cores: int
    memory_gib: float
    kernel: str
    load_1min: float


class Origin(msgspec.Struct, frozen=True):
    """The origin that every report contains."""

    machine: Machine
    commit: str
    python: str = ""
    libraries: dict[str, str] = {}
    dirty: bool = False
    bench: str = ""
    fuzz: str = ""
    seed: int | str | None = None


class Ends(msgspec.Struct, frozen=True):
    """The summary of `bench.follow`: target -> first, last or grown -> figure."""

    ends: dict[str, dict[str, dict[str, float]]] = {}


class Verdict(msgspec.Struct, frozen=True):
    """One sentence of a run's verdict."""

    about: str
    sentence: str


class Soak(msgspec.Struct, frozen=True):
    """What is shown of `bench.soak`; memory is process -> first_mb, last_mb, grown_mb."""

    memory: dict[str, dict[str, float]]
    overlap: Ends = Ends()
    verdict: list[Verdict] = []


class Spread(msgspec.Struct, frozen=True):
    """A figure over rounds."""

    median: float
    min: float
    max: float

    @property
    def told(self) -> str:
        """The three, as a cell."""
        return spread(self.median, self.min, self.max)


class Loop(msgspec.Struct, frozen=True):
    """What is shown of `bench.loop` beside its other graphs; figure -> spread over rounds."""

    loop: dict[str, Spread]
    sum_of_handlers_ms: Spread


class Watching(msgspec.Struct, frozen=True):
    """What is shown of `bench.watching`; way of watching -> figure -> spread over rounds."""

    graph: str
    frames: int
    n: int
    summary: dict[str, dict[str, Spread]]


SHAPES: Mapping[str, type[msgspec.Struct]] = {"follow": Ends, "soak": Soak, "watching": Watching}


class Beyond(msgspec.Struct, frozen=True):
    """Milliseconds beyond writing and reading every byte."""

    p50: float
    p99: float


class Hop(msgspec.Struct, frozen=True):
    """What is shown of a contestant of `bench.bus` at one size."""

    contestant: str
    nbytes: int
    lost: int
    beyond_ms: Beyond


class Bus(msgspec.Struct, frozen=True):
    """What is shown of `bench.bus`."""

    figures: list[Hop]
    rounds: int
    count_per_round: int
    rate_hz: float


@dataclass(frozen=True, kw_only=True)
class Report:
    """A bench's own result file."""

    path: Path
    bench: str
    origin: Origin
    values: Mapping[str, Any]


def read_report(path: Path, values: Any) -> Report:
    """Return a bench's report; raises `ResultError` for a file without its origin."""
    if not isinstance(values, Mapping):
        got = type(values).__name__
        raise ResultError(f"{path.name}: expected an object, a table or a report, got {got}")
    origin = _convert(path, values, Origin)
    bench = "fuzz" if origin.fuzz else origin.bench or path.stem
    if bench in SHAPES:
        _convert(path, values, SHAPES[bench])
    if origin.commit[:8] in BEFORE_RENAMING:
        values = {**values, "graph": renamed(values.get("graph"))}
    return Report(path=path, bench=bench, origin=origin, values=values)


def renamed(graph: Any) -> Any:
    """Return what a report calls its graph, with the name that the graph has today.

    >>> renamed("graphs/tracking.yaml"), renamed("graphs/text.yaml")
    ('graphs/tracking.yaml (today graphs/learned.yaml)', 'graphs/text.yaml')
    """
    if not isinstance(graph, str):
        return graph
    name = graph.rpartition("/")[2].removesuffix(".yaml")
    return f"{graph} (today {graph.replace(name, TODAY[name])})" if name in TODAY else graph


def _convert(path: Path, values: Any, kind: type[T]) -> T:
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        what = str(error)
        where = "neither a table with an id nor a bench's report"
        raise ResultError(f"{path.name}: {where}: {what[:1].lower()}{what[1:]}") from error


def place_of(report: Report) -> Place:
    """Return the report's place in the page."""
    found = PLACES.get(report.bench, ELSEWHERE)
    return found if found.title else Place(
        section=found.section, order=found.order, title=report.path.stem
    )  # fmt: skip


def render_reports(reports: Sequence[Report]) -> str:
    """Return the Markdown of all reports of one bench."""
    parts = [f"### {place_of(reports[0]).title}"]
    if reports[0].bench == "fuzz":
        return "\n\n".join([*parts, *(origin_of(r) for r in reports), _fuzz(reports)])
    if len(reports) > 1 and reports[0].bench in OVERVIEWS:
        parts.append(OVERVIEWS[reports[0].bench](reports))
    for report in reports:
        if len(reports) > 1:
            parts.append(f"#### {report.path.stem}")
        parts.append(origin_of(report))
        parts += [f"![{path.stem}](results/{path.name})" for path in plots_of(report)]
        parts += FORMS.get(report.bench, _values)(report)
    return "\n\n".join(parts)


def origin_of(report: Report) -> str:
    """Return where and by what a report was measured."""
    origin, machine = report.origin, report.origin.machine
    versions = {"Python": origin.python, **origin.libraries}
    return lines({
        "Source": f"measured (`bench/results/{report.path.name}`)",
        "Machine": f"{machine.cpu}, {machine.cores} cores, {machine.memory_gib} GiB, "
                   f"Linux {machine.kernel}, load {machine.load_1min}",
        "Versions": ", ".join(f"{name} {v}" for name, v in versions.items() if v),
        "Commit": f"{origin.commit[:7]}{', with local changes' if origin.dirty else ''}",
        "Seed": "" if origin.seed is None else str(origin.seed),
    })  # fmt: skip


def plots_of(report: Report) -> list[Path]:
    """Return the pictures beside a report, whose names begin with its own."""
    others = {path.stem for path in report.path.parent.glob("*.json")} - {report.path.stem}
    found = sorted(report.path.parent.glob(f"{report.path.stem}*.png"))
    return [path for path in found if path.stem not in others]


def _fuzz(reports: Sequence[Report]) -> str:
    names = ("cases", "accepted", "refused", "tracebacks", "hangs", "bad_sentences",
             "files_touched", "slowest_ms")  # fmt: skip
    rows = [[r.origin.fuzz, *(cell(r.values.get(n)) for n in names)] for r in reports]
    return table(["input", *(n.replace("_", " ") for n in names)], rows)


def _follow(report: Report) -> list[str]:
    """Return Markdown of means of the first ten spans and the last ten, and of every span."""
    return _spans(report.values)


def _soak(report: Report) -> list[str]:
    """Return Markdown of the verdict, each process's memory, and IoU and share by minute."""
    found = msgspec.convert(report.values, Soak)
    verdict = lines({v.about: v.sentence for v in found.verdict})
    memory = [
        [name, *(cell(grown.get(part)) for part in ("first_mb", "last_mb", "grown_mb"))]
        for name, grown in found.memory.items()
    ]
    columns = ["process", "first minute, MB", "last minute, MB", "grown, MB"]
    return [verdict, table(columns, memory), *_spans(report.values.get("overlap", {}))]


def _loops(reports: Sequence[Report]) -> str:
    """Return a table of the loop with every graph that was measured."""
    shown = {
        "latency_ms_p50": "loop p50, ms", "latency_ms_p99": "p99, ms",
        "overhead_ms_p50": "beyond the handlers p50, ms",
    }  # fmt: skip
    rows = []
    for report in reports:
        found = _convert(report.path, report.values.get("summary"), Loop)
        figures_ = [found.loop[name].told if name in found.loop else "–" for name in shown]
        rows.append([report.path.stem, *figures_, found.sum_of_handlers_ms.told])
    return table(["report", *shown.values(), "handlers on its way, ms"], rows)


def _watching(report: Report) -> list[str]:
    """Return Markdown of how the graph ran by how it was watched: median (least to greatest)."""
    found = _convert(report.path, report.values, Watching)
    columns = list(dict.fromkeys(name for row in found.summary.values() for name in row))
    rows = [
        [how, *(row[name].told if name in row else "–" for name in columns)]
        for how, row in sorted(found.summary.items(), key=lambda item: item[1]["p50_ms"].median)
    ]
    about = f"{found.n} rounds of {found.frames} frames of {found.graph}; the order is random."
    return [about, table(["watched by", *(name.replace("_", " ") for name in columns)], rows)]


def _bus(report: Report) -> list[str]:
    """Return Markdown of one hop: a row for each size, a column for each transport."""
    found = _convert(report.path, report.values, Bus)
    hops = {(hop.nbytes, hop.contestant): hop for hop in found.figures}
    shown = {hop.contestant for hop in found.figures}
    names = [name for name in LABELS if name in shown] + sorted(shown - LABELS.keys())
    rows = []
    for nbytes in sorted({hop.nbytes for hop in found.figures}):
        own = [hops.get((nbytes, name)) for name in names]
        rows.append([f"{nbytes / 1e6:.2g} MB", *(_hop(hop) for hop in own)])
    about = (
        f"ms beyond writing and reading every byte, p50 / p99, in {found.rounds} rounds of "
        f"{found.count_per_round} messages at {found.rate_hz:g} Hz."
    )
    return [about, table(["payload", *(LABELS.get(name, name) for name in names)], rows)]


def _hop(hop: Hop | None) -> str:
    if hop is None:
        return "–"
    lost = f", {hop.lost} lost" if hop.lost else ""
    return f"{hop.beyond_ms.p50:.2f} / {hop.beyond_ms.p99:.2f}{lost}"


def _spans(values: Mapping[str, Any]) -> list[str]:
    parts = ("first", "last", "grown")
    rows = [
        [target, figure, *(cell(ends.get(part, {}).get(figure)) for part in parts)]
        for target, ends in msgspec.convert(values, Ends).ends.items()
        for figure in ends.get("first", {})
    ]
    note = "First and last are up to ten spans each: of fewer than twenty spans they share some."
    columns = ["target", "figure", "first", "last", "difference"]
    plain = {k: v for k, v in values.items() if k != "ends"}
    return [table(columns, rows), note, *rows_of(plain)]


def _values(report: Report) -> list[str]:
    """Return Markdown of any report: all its figures but its origin."""
    own = {k: v for k, v in report.values.items() if k not in Origin.__struct_fields__}
    return figures(own)


def _strategies(report: Report) -> list[str]:
    """Return Markdown of a report of `fovea eval`: intervals as text, single trials left out."""
    told = [_of_strategy(row) for row in report.values.get("rows", ())]
    names = dict.fromkeys(name for row in told for name in row)
    rows = [{name: row.get(name) for name in names} for row in told]
    return _values(replace(report, values={**report.values, "rows": rows}))


def _tracks(report: Report) -> list[str]:
    """Return Markdown of tracks: means over clips with their intervals; clips stay in the file."""
    means = [_of_interval(row) for row in report.values.get("means", ())]
    return _values(replace(report, values={**report.values, "means": [], "rows": means}))


def _of_interval(row: Mapping[str, Any]) -> dict[str, Any]:
    """Put the interval of a figure beside it, in one cell."""
    found: dict[str, Any] = {}
    for key, value in row.items():
        if not key.endswith(INTERVAL):
            interval = row.get(f"{key}{INTERVAL}")
            found[key] = spread(value, *interval) if interval else value
    return found


def _of_strategy(row: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in row.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found |= _of_strategy(value, f"{name}: ")
        elif isinstance(value, list):
            if len(value) <= LONGEST_INTERVAL:
                found[name] = " to ".join(cell(part) for part in value)
        else:
            found[name] = value
    return found


OVERVIEWS: Mapping[str, Callable[[Sequence[Report]], str]] = {"loop": _loops}
FORMS: Mapping[str, Callable[[Report], list[str]]] = {
    "follow": _follow, "soak": _soak, "watching": _watching, "bus": _bus,
    "many": _tracks, "reading": _strategies, "shirts": _strategies, "manipulation": _strategies,
}  # fmt: skip
