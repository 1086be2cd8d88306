"""What a run tells can be read in a narrow terminal."""

from pathlib import Path

from rich.console import Console

from pipeline.bus.ledger import Ledger
from pipeline.graph.loader import load
from pipeline.run.report import compose, tables
from pipeline.terminal import not_delivered

ROOT = Path(__file__).resolve().parents[2]


def test_every_end_of_the_shipped_graph_stands_whole_in_80_columns(tmp_path: Path) -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")
    ledger = Ledger.create(tmp_path / "ledger", len(plan.edges), len(plan.nodes))
    console = Console(width=80)

    with console.capture() as caught:
        console.print(tables(compose(plan, ledger, {}, {}, duration_s=1.0)))

    words = caught.get().split()
    for edge in plan.edges:
        assert edge.origin in words
        assert edge.end in words


def test_whatever_was_not_delivered_is_named_and_nothing_else() -> None:
    account = {"dropped": {"superseded": 3}, "in_flight": 0, "lost_in_crash": 1}

    assert not_delivered(account) == "3 dropped, superseded; 1 lost in a crash"
    assert not_delivered({"dropped": {}, "in_flight": 2, "lost_in_crash": 0}) == "2 in flight"
    assert not_delivered({"dropped": {}, "in_flight": 0, "lost_in_crash": 0}) == "0"
