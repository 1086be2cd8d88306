"""`ps` and `top` show every node that was deployed, and text from outside as it is."""

from rich.console import Console, RenderableType

from pipeline.cli.tables import health_table, process_table, settings_table, top_tables
from pipeline.client.graph_client import Said, Status
from pipeline.protocol.fleet import NodeState, Process, State
from pipeline.protocol.questions import NodeSettings

NODES = {"capture": "sensor", "saliency": "compute", "policy": "compute"}


def shown(table: RenderableType) -> list[str]:
    console = Console(width=300)
    with console.capture() as caught:
        console.print(table)
    return caught.get().splitlines()


def state(label: str, *nodes: str, phase: str = "running", failure: str = "") -> State:
    processes = tuple(Process(name, (name,), 7, 1.0, 2.0, 0, 0) for name in nodes)
    return State("hosts", label, 0, phase, failure, processes, (), (), (), {})


def ps(label: str, said: Said) -> list[str]:
    nodes = {node: host for node, host in NODES.items() if host == label}
    return shown(process_table([Status(graph="hosts", hosts={label: said}, nodes=nodes)]))


def test_the_nodes_of_a_silent_host_are_each_marked_lost() -> None:
    lines = ps("compute", "compute: no agent answers")

    for node in ("saliency", "policy"):
        assert [line for line in lines if node in line and "lost" in line], lines
    assert not [line for line in lines if "capture" in line]


def test_a_node_that_a_host_should_run_and_does_not_is_marked() -> None:
    failed = ps("compute", [state("compute", "saliency", phase="failed")])

    assert [line for line in failed if "policy" in line and "failed" in line]
    assert not [line for line in failed if "saliency" in line and "failed" in line]
    assert [line for line in ps("sensor", []) if "capture" in line and "gone" in line]


def test_top_keeps_the_nodes_of_a_lost_host_in_sight() -> None:
    hosts: dict[str, Said] = {"sensor": [state("sensor", "capture")], "compute": "nobody answers"}
    now = Status(graph="hosts", hosts=hosts, nodes=NODES)

    lines = shown(top_tables(Status(graph="hosts", hosts={}, nodes=NODES), now, 1.0))

    for node in ("saliency", "policy"):
        assert [line for line in lines if node in line and "lost" in line], lines


def test_text_from_outside_is_not_taken_for_markup() -> None:
    why = "no such device [/dev/video0] [red]"

    assert why in "".join(ps("sensor", [state("sensor", "[/x]", phase="failed", failure=why)]))
    assert "[/x]" in "".join(ps("sensor", [state("sensor", "[/x]")]))
    assert "[/a]" in "".join(shown(health_table({"[/g]": {"[/a]": None}})))
    assert "[/tmp]" in "".join(
        shown(settings_table(NodeSettings(settings={"at": ["[/tmp]"]}, live=())))
    )


def test_top_says_what_computes_the_network_of_a_node() -> None:
    none = {"p50": 0.0, "p99": 0.0}
    nodes = tuple(
        NodeState(name, "waiting", 1, 9, 9, none, none, none, *on)
        for name, *on in (("saliency", "cuda"), ("dispatch",))
    )
    both = State("g", "", 0, "running", "", (), nodes, (), (), {})
    now = Status(graph="g", hosts={"": (both,)}, nodes={})

    lines = shown(top_tables(now, now, 1.0))

    assert [line.split()[:3] for line in lines if "waiting" in line] == [
        ["saliency", "waiting", "cuda"], ["dispatch", "waiting", "1"],
    ]  # fmt: skip
