"""A table as a result file: where its figures come from, its columns and rows, its notes.

Benches write reports of their own (`bench.results.report`); this format is for figures that were
put together by hand or transcribed from an earlier text. `source` names their origin.
"""

from pathlib import Path

import msgspec

from bench.results.markdown import cell, lines, table
from pipeline.errors import FoveaError

SECTIONS = (
    "Conditions",
    "Time and transport",
    "Faults, swaps and long runs",
    "Several hosts and security",
    "Networks and scenes",
    "All tasks",
    "Tracking under a pixel budget",
    "Reading under a pixel budget",
    "Manipulation under a pixel budget",
    "Late plans",
    "Time of each part",
    "Training and set-up",
    "Decisions",
)


class ResultError(FoveaError):
    """A result file is invalid."""


class ResultTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One table of `RESULTS.md`. An empty text means: not known, or it does not apply."""

    id: str  # the name of its file
    section: str  # one of SECTIONS
    order: int  # position within the section
    title: str
    out_of_date: str = ""  # what has been replaced since
    source: str  # "README at commit …" for transcribed figures, or the name of a bench's file
    command: str = ""  # what measures it
    data: str = ""
    machine: str = ""
    commit: str = ""  # of the code that was measured
    date: str = ""
    seed: int | None = None
    n: str = ""  # sample size
    spread: str = ""  # what a range or an interval in the rows means
    asked: str = ""  # the required value
    reference: str = ""  # the paper's figure or a peer's, and its source
    columns: list[str]
    rows: list[list[str | int | float | None]]
    notes: list[str] = []  # paragraphs
    plot: str = ""  # a picture beside the file; without: that of the same name, if there is one


_DECODER = msgspec.json.Decoder(ResultTable)


def read_table(path: Path, text: bytes) -> ResultTable:
    """Return the table of a file; raises `ResultError` with one sentence.

    >>> read_table(Path("bus.json"), b"{}")
    Traceback (most recent call last):
    bench.results.table.ResultError: bus.json: object missing required field `id`
    """
    try:
        found = _DECODER.decode(text)
    except msgspec.MsgspecError as error:
        what = str(error)
        raise ResultError(f"{path.name}: {what[:1].lower()}{what[1:]}") from error
    if found.id != path.stem:
        raise ResultError(f"{path.name}: id: expected {path.stem}, got {found.id}")
    if found.section not in SECTIONS:
        known = ", ".join(SECTIONS)
        raise ResultError(f"{path.name}: section: expected one of {known}, got {found.section}")
    for number, row in enumerate(found.rows):
        if len(row) != len(found.columns):
            expected = f"expected {len(found.columns)} cells, got {len(row)}"
            raise ResultError(f"{path.name}: rows[{number}]: {expected}")
    if found.plot and not (path.parent / found.plot).is_file():
        raise ResultError(f"{path.name}: plot: expected a file beside it, got {found.plot}")
    return found


def render(found: ResultTable, folder: Path) -> str:
    """Return the Markdown of a table of a folder, with its origin above it."""
    transcribed = found.source.startswith("README")
    origin = f"transcribed: {found.source}" if transcribed else found.source
    facts = {
        "Source": f"{origin} (`bench/results/{found.id}.json`)",
        "Command": f"`{found.command}`" if found.command else "",
        "Data": found.data,
        "Machine": found.machine,
        "Commit": found.commit,
        "Date": found.date,
        "Seed": "" if found.seed is None else str(found.seed),
        "Sample size": found.n,
        "Spread": found.spread,
        "Asked for": found.asked,
        "Reference": found.reference,
    }
    parts = [f"### {found.title}", lines(facts)]
    if found.out_of_date:
        parts.insert(1, f"**Out of date:** {found.out_of_date}")
    if found.rows:
        parts.append(table(found.columns, [[cell(c) for c in row] for row in found.rows]))
    plot = found.plot or f"{found.id}.png"
    if (folder / plot).is_file():
        parts.append(f"![{found.title}](results/{plot})")
    return "\n\n".join([*parts, *found.notes])
