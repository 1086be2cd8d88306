"""In the plot of an evaluation every curve is visible and distinct from the others."""

from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.container import ErrorbarContainer
from matplotlib.lines import Line2D

from bench.tracking.plots import figure_of, plot

NAMES = ["centred", "foveated", "full", "oracle", "round_robin", "spatial", "temporal"]
BUDGETS = ["1/4", "1/8", "1/16"]


def row(strategy: str, budget: str, target: str = "ball", **told: Any) -> dict[str, Any]:
    names = {"target": target, "strategy": strategy, "budget": budget}
    return names | {"iou": 0.5, "ci95": None} | told


def coinciding(target: str = "ball", names: list[str] = NAMES, **told: Any) -> list[dict[str, Any]]:
    """Return rows with the same figures, which is the worst case for a plot."""
    plain = [row(n, b, target, **told) for n in names if n != "full" for b in BUDGETS]
    return [*plain, *([row("full", "1", target, **told)] if "full" in names else [])]


def curves(panel: Axes) -> dict[str, Line2D]:
    found = [c for c in panel.containers if isinstance(c, ErrorbarContainer)]
    return {str(c.get_label()): c.lines[0] for c in found if c.lines[0] is not None}


def test_every_strategy_is_drawn_with_all_its_budgets_in_every_panel() -> None:
    figure = figure_of([*coinciding("ball"), *coinciding("player", ["foveated", "spatial"])])

    ball, player = figure.axes

    assert [ball.get_title(), player.get_title()] == ["ball", "player"]
    assert set(curves(ball)) == set(NAMES)
    assert set(curves(player)) == {"foveated", "spatial"}
    for name, line in curves(ball).items():
        assert len(line.get_ydata()) == (1 if name == "full" else 3)  # type: ignore[arg-type]
        assert line.get_visible()


def test_curves_of_the_same_figures_neither_look_alike_nor_lie_on_one_another() -> None:
    (panel,) = figure_of(coinciding()).axes

    for one, other in combinations(curves(panel).values(), 2):
        assert one.get_marker() != other.get_marker()
        assert to_hex(one.get_color()) != to_hex(other.get_color())
        assert one.get_linewidth() > other.get_linewidth()  # drawn first, below the narrower one
        assert not set(one.get_xdata()) & set(other.get_xdata())  # type: ignore[arg-type]


def test_markers_that_coincide_are_drawn_apart() -> None:
    figure = figure_of(coinciding())
    figure.canvas.draw()
    (panel,) = figure.axes

    places = sorted(
        panel.transData.transform((line.get_xdata()[0], 0.5))[0]  # type: ignore[index]
        for name, line in curves(panel).items()
        if name != "full"
    )

    assert min(b - a for a, b in pairwise(places)) >= 2  # pixels of the screen
    assert places[-1] - places[0] < panel.transData.transform((1 / 8, 0))[0] - places[0]


@pytest.mark.parametrize("count", [14, 40])
def test_many_rows_of_one_strategy_have_distinct_curves(count: int) -> None:
    names = [f"foveated, delay {k}" for k in range(count)]

    (panel,) = figure_of(coinciding(names=names)).axes

    looks = {(line.get_marker(), line.get_linestyle()) for line in curves(panel).values()}
    assert len(looks) == count


def test_the_budgets_are_written_as_fractions() -> None:
    figure = figure_of(coinciding())
    figure.canvas.draw()
    (panel,) = figure.axes

    assert [label.get_text() for label in panel.get_xticklabels()] == ["1/16", "1/8", "1/4", "1"]
    assert [label.get_text() for label in panel.get_xticklabels(minor=True)] == []
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("share of the pixels", "IoU")


def test_the_legend_names_every_curve_once_and_covers_none() -> None:
    figure = figure_of([*coinciding("ball", NAMES[:4]), *coinciding("player", NAMES[3:])])
    figure.canvas.draw()

    (legend,) = figure.legends

    assert [text.get_text() for text in legend.get_texts()] == NAMES
    box = legend.get_window_extent()
    assert not any(box.overlaps(panel.get_window_extent()) for panel in figure.axes)


def test_an_interval_is_drawn_where_there_is_one_and_none_where_there_is_not() -> None:
    (with_ends,) = figure_of(coinciding(ci95=[0.4, 0.7])).axes
    (without,) = figure_of(coinciding()).axes

    for panel, drawn in ((with_ends, True), (without, False)):
        for container in panel.containers:
            assert isinstance(container, ErrorbarContainer)
            assert container.has_yerr is drawn
    (bar,) = with_ends.containers[0].lines[2]  # type: ignore[attr-defined]
    ends = bar.get_segments()[0][:, 1]
    assert list(ends) == pytest.approx([0.4, 0.7])


def test_rows_without_a_figure_are_left_out(tmp_path: Path) -> None:
    plot([row("spatial", "1/8", iou=None)], tmp_path / "none.png")
    plot([row("spatial", "1/8", iou=None), row("full", "1")], tmp_path / "some.svg")

    assert not (tmp_path / "none.png").exists()
    assert (tmp_path / "some.svg").stat().st_size > 1000


def test_long_starts_have_a_panel_of_their_own_with_the_same_strategies() -> None:
    short = {"target": "ball", "strategy": "full", "budget": "1", "iou": 0.5, "ci95": None}
    long = short | {"strategy": "full, long", "protocol": "long", "iou": 0.3}

    figure = figure_of([short, long])

    assert [panel.get_title() for panel in figure.axes] == ["ball", "ball, long"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["full"]
