"""The accounts of a graph: spare pages, and whether anything is in flight."""

from pathlib import Path

import pytest

from operators.visualise import Visualise
from pipeline.bus.ledger import PROVIDER_BYTES, ROOM_EDGES, ROOM_NODES, private_ledger
from pipeline.client.viewing import wiring
from pipeline.contract import inputs_of
from pipeline.graph.editing import loaded_ports
from pipeline.graph.loader import load

VIEWERS = 4  # at once, beside a recorder


def test_a_message_in_flight_on_any_edge_is_seen_beside_unused_pages():
    ledger = private_ledger(5, 1)
    first, last = ledger.edges[0], ledger.edges[-1]

    assert ledger.drained()
    first.sent = 3
    first.acknowledge("delivered", 2)
    assert not ledger.drained()
    first.acknowledge("superseded")
    assert ledger.drained()
    last.sent = 1
    assert not ledger.drained()


@pytest.mark.parametrize("graph", ["tracking", "several_rois", "many", "text"])
def test_viewers_and_a_recorder_of_everything_fit_into_a_running_graph(graph: str):
    plan = load(Path("graphs") / f"{graph}.yaml")
    read = {(edge.source, edge.output) for edge in plan.edges}

    seen = wiring(plan, loaded_ports(plan))

    assert VIEWERS * len(seen) + len(read) <= ROOM_EDGES
    assert ROOM_NODES > VIEWERS
    assert set(seen) <= set(inputs_of(Visualise))


@pytest.mark.parametrize(
    ("written", "read"),
    [("cuda, cpu", "cuda, cpu"), ("", ""), ("x" * 99, "x" * (PROVIDER_BYTES - 1)), ("é", "?")],
)
def test_what_computes_a_nodes_networks_is_bounded_and_harmless(written: str, read: str):
    (account,) = private_ledger(0, 1).nodes
    account.provider, account.epoch = "tensorrt", 3

    account.provider = written

    assert account.provider == read
    assert (account.epoch, account.absent_until_ns) == (3, 0)
    account.clear()
    assert account.provider == ""
