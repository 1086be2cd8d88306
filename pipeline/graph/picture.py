"""Draw a plan as SVG: nodes below one another, writers first, each with the inputs it reads.

Every output that is read has a line of its own to the left of the nodes, with an arrow into each
input that reads it. Lines cross, but none lies along another one or on a text.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as Xml

from pipeline.graph.drawing import Arrow, Live, arrows, place
from pipeline.graph.plan import Plan

ROW_PX, LANE_PX, MARGIN_PX, INDENT_PX = 24, 16, 20, 26
TEXT_PX = 13
START_PX = 4, -4, 0, 8, -8  # of the outputs of a node, below its middle
LETTER_PX = 0.56 * TEXT_PX  # about the width of a letter
INK, GREY = "#1b1f24", "#57606a"
LINES = "#0969da", "#1a7f37", "#bc4c00", "#8250df", "#bf3989", "#9a6700", "#0e7490", GREY
FILLS = "#dbeafe", "#dcfce7", "#fef3c7", "#fae8ff", "#ffe4e6", "#e0f2f1"  # of hosts and groups
PLAIN = "#f6f8fa"


@dataclass(frozen=True, kw_only=True)
class Line:
    """An output with its readers."""

    source: int  # row of its node
    number: int  # among the outputs of that node
    readers: tuple[tuple[int, Arrow], ...]  # row of each input

    @property
    def rows(self) -> tuple[int, int]:
        """First and last row that it meets."""
        met = [self.source, *(row for row, _ in self.readers)]
        return min(met), max(met)


def svg(plan: Plan, live: Live | None = None) -> str:
    """Return the picture; lossless edges are thick, sensor commands dashed."""
    drawn = {arrow.edge.end: arrow for arrow in arrows(plan, live)}
    rows = _rows(plan)
    lines = _lines(plan, drawn, rows)
    lanes = lanes_of([line.rows for line in lines])
    left = MARGIN_PX + LANE_PX * (1 + max(lanes, default=0))
    texts = [_of_input(arrow) for arrow in drawn.values()]
    texts += [f"{node.name}  {node.operator}  {place(node)}" for node in plan.nodes]
    width = left + 2 * INDENT_PX + LETTER_PX * max(map(len, texts)) + MARGIN_PX
    height = 2 * MARGIN_PX + ROW_PX * len(rows)
    root = Xml.Element(
        "svg", xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {width:g} {height:g}",
        width=f"{width:g}", height=f"{height:g}",
    )  # fmt: skip
    Xml.SubElement(root, "title").text = plan.name
    Xml.SubElement(root, "rect", width="100%", height="100%", fill="white")
    _nodes(root, plan, rows, left, width - left - MARGIN_PX)
    for arrow in drawn.values():
        _text(root, _of_input(arrow), left + INDENT_PX, _middle(rows[arrow.edge.end]), INK)
    for number, (line, lane) in enumerate(zip(lines, lanes, strict=True)):
        _draw(root, line, left - LANE_PX * (lane + 1), left, LINES[number % len(LINES)])
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode")


def lanes_of(spans: Iterable[tuple[int, int]]) -> list[int]:
    """Return a lane for each span of rows; spans that share a row have different lanes.

    >>> lanes_of([(0, 2), (1, 5), (3, 4)])
    [0, 1, 0]
    """
    taken: list[list[tuple[int, int]]] = []
    found = []
    for first, last in spans:
        free = (
            number for number, lane in enumerate(taken)
            if all(last < other[0] or first > other[1] for other in lane)
        )  # fmt: skip
        lane = next(free, len(taken))
        if lane == len(taken):
            taken.append([])
        taken[lane].append((first, last))
        found.append(lane)
    return found


def _rows(plan: Plan) -> dict[str, int]:
    """Return the row of every node and of every `node.input`."""
    found: dict[str, int] = {}
    for name in plan.order():
        for what in (name, *(edge.end for edge in plan.inputs(name).values())):
            found[what] = len(found)
    return found


def _lines(plan: Plan, drawn: Mapping[str, Arrow], rows: Mapping[str, int]) -> list[Line]:
    """Return the lines, short ones first: these lie nearest to the nodes."""
    found = []
    outputs: dict[str, list[str]] = {}
    for edge in plan.edges:
        if edge.origin not in (told := outputs.setdefault(edge.source, [])):
            told.append(edge.origin)
    for node, origins in outputs.items():
        for number, origin in enumerate(origins):
            ends = [edge.end for edge in plan.edges if edge.origin == origin]
            readers = tuple((rows[end], drawn[end]) for end in ends)
            found.append(Line(source=rows[node], number=number, readers=readers))
    return sorted(found, key=lambda line: line.rows[1] - line.rows[0])


def _of_input(arrow: Arrow) -> str:
    return f"{arrow.edge.input} ← {arrow.edge.origin} · {arrow.told}"


def _nodes(
    root: Xml.Element, plan: Plan, rows: Mapping[str, int], left: float, width: float
) -> None:
    kinds = list(dict.fromkeys(place(node) for node in plan.nodes if place(node)))
    for node in plan.nodes:
        where, y = place(node), _middle(rows[node.name])
        fill = FILLS[kinds.index(where) % len(FILLS)] if where else PLAIN
        Xml.SubElement(
            root, "rect", x=f"{left:g}", y=f"{y - ROW_PX / 2 + 2:g}", width=f"{width:g}",
            height=f"{ROW_PX - 4:g}", rx="4", fill=fill, stroke=GREY,
        )  # fmt: skip
        _text(root, node.name, left + 8, y, INK, bold=True)
        after = left + 24 + LETTER_PX * 1.15 * len(node.name)
        _text(root, node.operator + (f" ({where})" if where else ""), after, y, GREY)


def _draw(root: Xml.Element, line: Line, lane: float, left: float, colour: str) -> None:
    """Draw an output's line in its lane, and an arrow into each reader."""
    start = _middle(line.source) + START_PX[line.number % len(START_PX)]
    for row, arrow in line.readers:
        end, edge = _middle(row), arrow.edge
        path = f"M{left:g},{start:g} H{lane:g} V{end:g} H{left + INDENT_PX - 6:g}"
        tip = "m-6,-4 l6,4 l-6,4"
        drawn = Xml.SubElement(
            root, "path", {"stroke-width": "2.6" if arrow.keep == "every" else "1.3"},
            d=f"{path} {tip}", fill="none", stroke=colour,
        )  # fmt: skip
        drawn.set("stroke-linejoin", "round")
        if edge.command:
            drawn.set("stroke-dasharray", "5 4")
        Xml.SubElement(drawn, "title").text = f"{edge.origin} to {edge.end}: {arrow.told}"


def _middle(row: int) -> float:
    return MARGIN_PX + ROW_PX * (row + 0.5)


def _text(
    root: Xml.Element, words: str, x: float, y: float, colour: str, *, bold: bool = False
) -> None:
    given = {"font-size": str(TEXT_PX), "font-family": "sans-serif", "fill": colour}
    if bold:
        given["font-weight"] = "bold"
    Xml.SubElement(root, "text", given, x=f"{x:g}", y=f"{y + 4:g}").text = words
