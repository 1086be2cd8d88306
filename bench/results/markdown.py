"""Markdown from plain values: cells, tables and lists of facts."""

from collections.abc import Mapping, Sequence


def cell(value: object) -> str:
    """Return a value as it stands in a table; numbers with at most four significant digits.

    >>> [cell(v) for v in (None, True, 12345, 0.12345, 1234.5, "a|b")]
    ['–', 'yes', '12,345', '0.1235', '1,234', 'a\\\\|b']
    """
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return str(value).replace("|", "\\|").replace("\n", " ")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table of cells that are text already."""
    written = [_row([cell(c) for c in columns]), "|" + "---|" * len(columns)]
    return "\n".join([*written, *(_row(row) for row in rows)])


def table_of(rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table of flat rows with the same columns.

    >>> print(table_of([{"a": 1, "b": None}]))
    | a | b |
    |---|---|
    | 1 | – |
    """
    columns = list(rows[0])
    return table(columns, [[cell(row.get(column)) for column in columns] for row in rows])


def lines(facts: Mapping[str, str]) -> str:
    """Return facts as a list, one per line, without the empty ones.

    >>> lines({"Seed": "7", "Data": ""})
    '- Seed: 7'
    """
    return "\n".join(f"- {name}: {value}" for name, value in facts.items() if value)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
