"""Reports that benches wrote themselves (`--json`, `--out`): their origin, figures and rows."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.bus import CONTESTANTS
from bench.results.markdown import cell, lines, table, table_of
from bench.results.places import ELSEWHERE, PLACES, Place
from bench.results.table import ResultError

T = TypeVar("T")
LONGEST_LIST = 12  # values of a list that are shown in one cell
LONGEST_INTERVAL = 2
LABELS = {contestant.module: contestant.label for contestant in CONTESTANTS}
PLAIN = (str, int, float, type(None))


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
        return f"{cell(self.median)} ({cell(self.min)} to {cell(self.max)})"


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
    return Report(path=path, bench=bench, origin=origin, values=values)


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
    for report in reports:
        parts.append(origin_of(report))
        parts += FORMS.get(report.bench, _values)(report)
    return "\n\n".join(parts)


def origin_of(report: Report) -> str:
    """Return where and by what a report was measured."""
    origin, machine = report.origin, report.origin.machine
    versions = {"Python": origin.python, **origin.libraries}
    plots = sorted(p.name for p in report.path.parent.glob(f"{report.path.stem}*.png"))
    return lines({
        "Source": f"measured (`bench/results/{report.path.name}`)",
        "Machine": f"{machine.cpu}, {machine.cores} cores, {machine.memory_gib} GiB, "
                   f"Linux {machine.kernel}, load {machine.load_1min}",
        "Versions": ", ".join(f"{name} {v}" for name, v in versions.items() if v),
        "Commit": f"{origin.commit[:7]}{', with local changes' if origin.dirty else ''}",
        "Seed": "" if origin.seed is None else str(origin.seed),
        "Plot": ", ".join(f"[{name}](results/{name})" for name in plots),
    })  # fmt: skip


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
    return [table(columns, rows), note, *_tables(plain)]


def _values(report: Report) -> list[str]:
    """Return Markdown of any report: a table of its single figures, and one per list of rows."""
    flat = [[name, cell(value)] for name, value in _scalars(report.values)]
    return [table(["figure", "value"], flat), *_tables(report.values)]


def _tables(values: Mapping[str, Any]) -> list[str]:
    found = []
    for name, rows in values.items():
        if _is_rows(rows):
            found += [f"`{name}`:", table_of(rows)]
    return found


def _is_rows(value: Any) -> bool:
    """Whether a value is a list of mappings to single figures."""
    return bool(value) and isinstance(value, list) and all(
        isinstance(row, Mapping) and row and all(isinstance(v, PLAIN) for v in row.values())
        for row in value
    )  # fmt: skip


def _strategies(report: Report) -> list[str]:
    """Return Markdown of a report of `fovea eval`: intervals as text, single trials left out."""
    told = [_of_strategy(row) for row in report.values.get("rows", ())]
    names = dict.fromkeys(name for row in told for name in row)
    rows = [{name: row.get(name) for name in names} for row in told]
    return _values(replace(report, values={**report.values, "rows": rows}))


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


def _scalars(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every single figure below a mapping; lists of values are one text."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if name in Origin.__struct_fields__:
            continue
        if isinstance(value, Mapping):
            yield from _scalars(value, f"{name}.")
        elif isinstance(value, list):
            if len(value) <= LONGEST_LIST and not any(isinstance(v, (list, dict)) for v in value):
                yield name, json.dumps(value)
        else:
            yield name, value


FORMS: Mapping[str, Callable[[Report], list[str]]] = {
    "follow": _follow, "soak": _soak, "watching": _watching, "bus": _bus,
    "reading": _strategies, "shirts": _strategies, "manipulation": _strategies,
}  # fmt: skip
