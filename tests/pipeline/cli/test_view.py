"""`fovea view` attaches to a running graph and leaves without a trace."""

import os
import re
import secrets
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from threading import Timer
from time import monotonic, sleep

import psutil
import pytest

from pipeline.client.graph_client import Status, when_free
from pipeline.client.viewing import changed_settings, drops, happened, wiring
from pipeline.errors import Busy, RunError
from pipeline.graph.editing import loaded_ports
from pipeline.graph.loader import load
from pipeline.protocol.fleet import EdgeState, NodeState, Process, State
from pipeline.protocol.questions import NodeSettings
from pipeline.run.rundir import folder_of, running
from tests.commands import command
from tests.sample_graphs import CHAIN, PATIENCE_S, together

FOVEA = (sys.executable, "-m", "pipeline.entry")


@pytest.fixture
def name(tmp_path: Path) -> Iterator[str]:
    """Run a graph; return its name."""
    path = tmp_path / "graph.yaml"
    name = f"view-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{together(CHAIN, 'ticker', 'count', 'glance')}")
    subprocess.run([*FOVEA, "run", str(path), "--detach"], check=True, capture_output=True)
    yield name
    if name in running():
        psutil.Process(running()[name]["pid"]).kill()


View = subprocess.Popen[str]
Begin = Callable[..., View]


@pytest.fixture
def begin() -> Iterator[Begin]:
    """Return what starts `fovea view WORDS`; what still runs after the test is killed."""
    begun: list[View] = []

    def start(*words: str, **env: str) -> View:
        view = subprocess.Popen(
            [*FOVEA, "view", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, **env},
        )  # fmt: skip
        begun.append(view)
        return view

    try:
        yield start
    finally:
        for view in begun:
            view.kill()  # nothing for one that has ended
            view.wait(timeout=PATIENCE_S)
            assert view.stdout is not None
            view.stdout.close()


def next_line(view: View) -> str:
    """Return the next line that a view prints, empty at its end; kills one that says nothing."""
    assert view.stdout is not None
    late = Timer(PATIENCE_S, view.kill)  # which ends the line that is waited for
    late.start()
    try:
        return view.stdout.readline()
    finally:
        late.cancel()


def viewing(begin: Begin, name: str) -> View:
    """Start `fovea view` and wait until it watches."""
    view = begin(name, "--no-browser")
    assert re.match(rf"{name}: look at http://127\.0\.0\.1:\d+/\?url=rerun", next_line(view))
    return view


def test_two_views_at_once_wait_for_one_another(name: str, begin: Begin) -> None:
    views = [begin(name, "--no-browser") for _ in range(2)]
    first = [next_line(view) for view in views]
    joined = {node for node in nodes(name) if node.startswith("viewer")}
    for view in views:
        view.send_signal(signal.SIGINT)
        view.communicate(timeout=60)

    assert all(line.startswith(f"{name}: look at http://") for line in first), first
    assert len(set(first)) == 2
    assert joined == {f"viewer_{view.pid}" for view in views}
    assert [view.returncode for view in views] == [0, 0]


@pytest.mark.parametrize("refusals", [0, 3])
def test_a_change_waits_while_the_graph_is_busy(refusals: int) -> None:
    left = [Busy("g: another order is in progress")] * refusals

    def change() -> str:
        if left:
            raise left.pop()
        return "changed"

    assert when_free(change, 60.0) == "changed"


def test_a_change_waits_for_a_bounded_time_and_for_nothing_else() -> None:
    calls: list[RunError] = [Busy("g: another order is in progress"), RunError("g: no room")]

    def change() -> None:
        raise calls[-1]

    with pytest.raises(RunError, match="no room"):
        when_free(change, 60.0)
    calls.pop()
    with pytest.raises(Busy, match="another order"):
        when_free(change, 0.0)


def nodes(name: str) -> set[str]:
    return {node["name"] for node in running()[name]["nodes"]}


def settled(name: str, wanted: set[str]) -> set[str]:
    """Return the nodes, once they are these: a graph writes them down after it has answered."""
    deadline_s = monotonic() + PATIENCE_S
    while (found := nodes(name)) != wanted and monotonic() < deadline_s:
        sleep(0.05)
    return found


def test_a_view_joins_a_running_graph_and_leaves_it_as_it_was(name: str, begin: Begin) -> None:
    before = nodes(name)

    killed = viewing(begin, name)
    joined = nodes(name) - before
    killed.kill()
    killed.communicate()
    view = viewing(begin, name)  # takes away what the killed one left
    second = nodes(name) - before
    view.send_signal(signal.SIGINT)
    said = view.communicate(timeout=60)[0]

    assert joined == {f"viewer_{killed.pid}"}
    assert second == {f"viewer_{view.pid}"}
    assert view.returncode == 0
    assert said.splitlines()[-1] == f"{name}: goes on without the view"
    assert settled(name, before) == before


def test_a_view_that_is_interrupted_while_it_joins_leaves_no_viewer(
    name: str, begin: Begin
) -> None:
    before, view = nodes(name), begin(name, "--no-browser")
    late_s = monotonic() + PATIENCE_S
    while not [*folder_of(name).glob(f"viewer_{view.pid}*")] and monotonic() < late_s:
        sleep(0.01)  # until the viewer starts

    view.send_signal(signal.SIGINT)
    said = view.communicate(timeout=60)[0]

    assert settled(name, before) == before
    assert said.splitlines()[-1] == f"{name}: goes on without the view"
    assert view.returncode == 0
    sleep(2.0)  # for one that joins late
    assert nodes(name) == before


def test_a_view_ends_with_its_graph(name: str, begin: Begin) -> None:
    view = viewing(begin, name)

    assert command("stop", name).returncode == 0

    assert view.communicate(timeout=60)[0].splitlines()[-1] == f"{name}: the graph has ended"
    assert view.returncode == 0


def test_a_graph_that_does_not_run_is_named() -> None:
    done = command("view", "nowhere")

    assert done.returncode == 1
    assert done.stderr.startswith("fovea: no graph nowhere runs")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("graph", "differs"),
    [
        ("tracking", {"detections": "kits"}),
        ("prototype", {"context": "context_rgb", "roi": "roi_rgb"}),  # not the mosaics
        ("many", {"tracks": "identity"}),
    ],
)
def test_a_viewer_reads_what_the_graphs_own_consumers_read(
    graph: str, differs: dict[str, str]
) -> None:
    plan = load(Path("graphs") / f"{graph}.yaml")

    found = wiring(plan, loaded_ports(plan))

    expected = {
        "context": "capture.context", "roi": "capture.roi", "truth": "capture.truth",
        "detections": "saliency", "tracks": "association", "scanpath": "policy",
        "schedule": "dispatch", "percept": "tracker",
    } | differs  # fmt: skip
    assert {k: v for k, v in found.items() if k in expected} == {
        k: v for k, v in expected.items() if k != "percept" or graph != "many"
    }


def test_a_graph_with_nothing_to_show_is_refused() -> None:
    plan = load(Path("graphs/tracking.yaml"))
    bare = type(plan)(name="bare", clock=plan.clock, nodes=plan.nodes[1:2], edges=())

    with pytest.raises(RunError, match="bare: expected an output that can be shown, got none"):
        wiring(bare, lambda _node: type("None_", (), {"outputs": {}})())


def status(*, epoch: int = 0, crashes: int = 0, extra: str = "") -> Status:
    """Return the status of a graph with one node, or two."""
    state = NodeState(
        name="policy", condition="running", epoch=epoch, handled=0, last_seq=0, handler_ms={},
        hop_ms={}, loop_ms={},
    )  # fmt: skip
    both = [state] + ([NodeState(**{**_fields(state), "name": extra})] if extra else [])
    process = Process(
        name="policy", nodes=("policy",), pid=1, cpu_s=0, rss_mb=0, restarts=0, crashes=crashes
    )
    edges = [
        EdgeState(origin="capture.roi", end=end, account={"dropped": dropped}, age_ms={},
                  age_error_ms=0, broken=False, sent=9)
        for end, dropped in (("tracker.roi", {"superseded": 3}), ("viewer_7.roi", {"tap": 2}))
    ]  # fmt: skip
    found = State(
        graph="g", label="", at_ns=0, phase="running", failure="", processes=(process,),
        nodes=tuple(both), edges=tuple(edges), hosts=(), network_bytes={},
    )  # fmt: skip
    return Status(graph="g", hosts={"": (found,)}, nodes={})


def _fields(state: NodeState) -> dict[str, object]:
    return {name: getattr(state, name) for name in state.__struct_fields__}


@pytest.mark.parametrize(
    ("now", "lines"),
    [
        (status(), []),
        (status(epoch=1), ["policy: swapped, instance 1 runs now"]),
        (status(epoch=1, crashes=1), ["policy: its process crashed, and is restarted"]),
        (status(extra="record"), ["record: joined the graph"]),
        (status(extra="viewer_9"), []),
    ],
)
def test_what_happened_between_two_looks_is_told(now: Status, lines: list[str]) -> None:
    assert happened(status(), now) == lines


def test_an_instance_that_comes_after_a_crash_is_no_swap() -> None:
    crashed: set[str] = set()
    looks = [status(), status(crashes=1), status(epoch=1, crashes=1), status(epoch=2, crashes=1)]

    told = [happened(*pair, crashed) for pair in pairwise(looks)]

    assert told == [
        ["policy: its process crashed, and is restarted"], [],
        ["policy: swapped, instance 2 runs now"],
    ]  # fmt: skip


def test_drops_are_told_by_edge_and_reason_without_the_viewers_own() -> None:
    assert drops(status(), "viewer_7") == {"capture.roi to tracker.roi/superseded": 3}


class Asked:
    """A client of a graph whose only node has one live setting."""

    def __init__(self) -> None:
        self.target = "ball"

    def nodes(self) -> tuple[str, ...]:
        return ("policy", "viewer_7")

    def configure(self, node: str, _changes: object) -> NodeSettings:
        assert node == "policy"
        return NodeSettings(settings={"target": self.target, "other": 1}, live=("target",))


def test_a_live_setting_that_changed_is_told_once() -> None:
    client, known = Asked(), {}

    told = [changed_settings(client, known)]
    client.target = "player"
    told += [changed_settings(client, known) for _ in range(2)]

    assert told == [[], ['policy.target = "player"'], []]


def test_without_a_browser_the_address_is_printed_and_nothing_else(
    name: str, begin: Begin, tmp_path: Path
) -> None:
    view = begin(name, PATH=str(tmp_path))
    said = [next_line(view) for _ in range(2)]
    view.send_signal(signal.SIGINT)
    rest = view.communicate(timeout=60)[0]

    assert said[0].startswith(f"{name}: look at http://127.0.0.1:")
    assert rest.splitlines() == [f"{name}: goes on without the view"]
