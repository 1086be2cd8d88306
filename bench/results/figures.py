"""Markdown of any nested figures: facts as a list, alike groups as the rows of one table."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any, TypeAlias

from bench.results.markdown import cell, lines, table, table_of

LONGEST_LIST = 12  # values of a list that are shown in one cell
LONGEST_LINE = 12  # figures of one group in a line; more are a table
WIDEST = 9  # columns of a table with fewer rows than that, which is turned otherwise
PLAIN = (str, int, float, type(None))
# keys of a spread -> middle, least, greatest
SPREADS: Mapping[frozenset[str], tuple[str, str, str]] = {
    frozenset({"median", "min", "max"}): ("median", "min", "max"),
    frozenset({"p5", "p50", "p95"}): ("p50", "p5", "p95"),
}
# keys of an estimate -> its value; the other one is a pair, its interval
ESTIMATES: Mapping[frozenset[str], str] = {
    frozenset({"mean", "interval"}): "mean",
    frozenset({"share", "interval"}): "share",
}
BLANK: tuple[Any, ...] = ("", [], {})  # of a setting that was not given

Group: TypeAlias = tuple[tuple[str, ...], dict[str, str]]  # where it stands, and its figures


def spread(middle: object, least: object, greatest: object) -> str:
    """Return a figure and its range as a cell.

    >>> spread(27.125, 26.594, 27.13)
    '27.12 (26.59 to 27.13)'
    """
    return f"{cell(middle)} ({cell(least)} to {cell(greatest)})"


def figures(values: Mapping[str, Any]) -> list[str]:
    """Return the Markdown of all figures below a mapping, lists of rows among them.

    Groups as deep below the same mapping that share a figure are rows of a table; a group of its
    own is a line. Lists of rows deeper than the first level are left out.

    >>> print(figures({"graph": "a.yaml", "loop": {"p50": 24.1, "p99": 40}})[0])
    - Run: graph a.yaml
    - loop: p50 24.1, p99 40
    >>> print(figures({"ms": {"policy": {"p50": 1.5}, "saliency": {"p50": 12.0}}})[0])
    | ms | p50 |
    |---|---|
    | policy | 1.5 |
    | saliency | 12 |
    """
    facts: dict[str, str] = {}
    tables: list[str] = []
    for groups in _alike(_groups(values)):
        place, own = groups[0]
        if not place or (len(groups) == 1 and len(own) <= LONGEST_LINE):
            facts[": ".join(place) or "Run"] = _told(own)
        else:
            tables.append(_table(groups))
    facts["Ranges"] = "; ".join(_kinds(values))
    return [part for part in (lines(facts), *tables, *rows_of(values)) if part]


def rows_of(values: Mapping[str, Any]) -> list[str]:
    """Return a table for every list of flat rows, under its name where that says something."""
    found = []
    for name, rows in values.items():
        if _is_rows(rows):
            found += [*([] if name == "rows" else [f"`{name}`:"]), table_of(rows)]
    return found


def _is_rows(value: Any) -> bool:
    """Whether a value is a list of mappings to single figures."""
    return bool(value) and isinstance(value, list) and all(
        isinstance(row, Mapping) and row and all(isinstance(v, PLAIN) for v in row.values())
        for row in value
    )  # fmt: skip


def _groups(values: Mapping[str, Any], place: tuple[str, ...] = ()) -> Iterator[Group]:
    """Yield every mapping with single figures: first its own, then those below it."""
    own: dict[str, str] = {}
    for key, value in values.items():
        found = _single(value)
        if found is not None and not (value in BLANK and not place):
            own[key] = found
    if own:
        yield place, own
    for key, value in values.items():
        if isinstance(value, Mapping) and _single(value) is None:
            yield from _groups(value, (*place, key))


def _single(value: Any) -> str | None:
    """Return a figure as a cell, with its range, or None for what is more than one figure."""
    if isinstance(value, PLAIN):
        return cell(value)
    if isinstance(value, list):
        if len(value) <= LONGEST_LIST and all(isinstance(part, PLAIN) for part in value):
            return ", ".join(cell(part) for part in value) or "none"
        return None
    if not isinstance(value, Mapping):
        return None
    keys = frozenset(value)
    if keys in SPREADS and all(isinstance(part, PLAIN) for part in value.values()):
        return spread(*(value[name] for name in SPREADS[keys]))
    return _estimate(value) if keys in ESTIMATES else None


def _estimate(value: Mapping[str, Any]) -> str | None:
    """Return an estimate and, where there are samples enough for it, its interval as a cell."""
    middle, interval = value[ESTIMATES[frozenset(value)]], value["interval"]
    if not isinstance(middle, PLAIN):
        return None
    if not interval:
        return cell(middle)
    if (
        isinstance(interval, list)
        and len(interval) == 2
        and all(isinstance(v, PLAIN) for v in interval)
    ):
        return spread(middle, *interval)
    return None


def _kinds(values: Any) -> list[str]:
    """Return what the ranges in the cells are, each kind once."""
    found: dict[str, None] = {}
    if isinstance(values, Mapping):
        keys = frozenset(values)
        if keys in SPREADS:
            found["{} ({} to {})".format(*SPREADS[keys])] = None
        elif keys in ESTIMATES:
            found[f"{ESTIMATES[keys]} (interval)"] = None
        for value in values.values():
            found |= dict.fromkeys(_kinds(value))
    return list(found)


def _alike(groups: Iterator[Group]) -> Iterator[list[Group]]:
    """Yield groups that can be rows of one table: as deep below the same mapping, like figures."""
    for (depth, _), near in groupby(groups, key=lambda group: (len(group[0]), group[0][:1])):
        tables: list[list[Group]] = []
        for group in near:
            alike = (rows for rows in tables if depth > 1 and _share(rows, group))
            found = next(alike, None)
            if found is None:
                tables.append([group])
            else:
                found.append(group)
        yield from tables


def _share(rows: list[Group], group: Group) -> bool:
    """Whether a group has a figure that a row of the table has, too."""
    return any(own.keys() & group[1].keys() for _, own in rows)


def _told(own: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in own.items())


def _table(groups: list[Group]) -> str:
    """Return the table of alike groups; what all have in their place stands above its names."""
    places = [place for place, _ in groups]
    differs = [n for n, parts in enumerate(zip(*places, strict=True)) if len(set(parts)) > 1]
    shared = " ".join(part for n, part in enumerate(places[0]) if n not in differs)
    columns = list(dict.fromkeys(name for _, own in groups for name in own))
    if len(groups) < WIDEST < len(columns) and len(groups) * 2 <= len(columns):
        names = [" ".join(place[n] for n in differs) or "value" for place in places]
        rows = [[name, *(own.get(name, "–") for _, own in groups)] for name in columns]
        return table([shared, *names], rows)
    heads = [shared, *([""] * (len(differs) - 1))]
    rows = [
        [*(place[n] for n in differs), *(own.get(name, "–") for name in columns)]
        for place, own in groups
    ]
    return table([*heads, *columns], rows)
