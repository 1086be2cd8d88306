"""Record outputs of a running graph on this host: a recorder joins it as a node and leaves it.

The recorder reads by taps, so that in real time no node waits for it; what it loses is counted in
the graph's accounts. Of an output with a lossless reader, up to `DEPTH` messages may wait for it.
"""

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any

import msgspec
import psutil

from pipeline import codec
from pipeline.class_cache import adapter
from pipeline.client.graph_client import when_free
from pipeline.client.local import LocalGraph
from pipeline.contract import inputs_of
from pipeline.errors import FoveaError, RunError
from pipeline.graph.loader import Sent
from pipeline.graph.plan import Plan, load_operator
from pipeline.protocol.fleet import EdgeState
from pipeline.recording.recorder import CLOSE_S
from pipeline.recording.written import counted
from pipeline.settings import suggest
from pipeline.text import harmless

OPERATOR = "operators.record:Record"
NODE = "record"
DEPTH = 30  # messages of a lossless output that may wait for the recorder
LOOK_S = 0.2
END_S = CLOSE_S + 5.0  # for a recorder to end its file and its process
ASK_LOOKS = 25  # so many looks between two questions to the recorder


class Chosen(msgspec.Struct):
    """What a recorder reads: its inputs, and of which of them every message."""

    inputs: dict[str, str]  # input -> node.output
    every: tuple[str, ...]
    lossless: bool  # in lockstep, where the graph waits for the recorder


def plan_of(client: LocalGraph) -> Plan:
    """Return the plan of a running graph."""
    plan: Plan = adapter(Plan).validate_python(client.facts["plan"])
    return plan


def chosen(client: LocalGraph, wanted: Sequence[str]) -> Chosen:
    """Return the inputs that record these outputs; without any, all that a node reads.

    Raises `RunError` for an unknown output, or for more of one type than the recorder can read.
    """
    plan = plan_of(client)
    read = {f"{e.source}.{e.output}" for e in plan.edges if not e.tap}
    every = {f"{e.source}.{e.output}" for e in plan.edges if e.keep == "every" and not e.tap}
    outputs = dict.fromkeys(_full(name) for name in wanted) or dict.fromkeys(sorted(read))
    free = _inputs()
    found = Chosen({}, (), plan.clock == "lockstep")
    for output in outputs:
        sent = _sent(client, output)
        if not free.get(sent):
            kinds = ", ".join(sorted({kind.message for kind in free}))
            raise RunError(
                f"{output}: expected an output that {OPERATOR} has an input left for ({kinds}), "
                f"got {sent.message}; --edges chooses outputs"
            )
        name = free[sent].pop(0)
        found.inputs[name] = output
        if output in every or found.lossless:
            found.every = (*found.every, name)
    return found


@contextmanager
def begun(
    client: LocalGraph, path: Path, what: Chosen, settings: dict[str, Any]
) -> Iterator[list[str]]:
    """Add the recorder to the graph, and remove it after any outcome.

    Yields the files that look like parts of the recording and were there before. Raises
    `FoveaError` when the graph refuses it.
    """
    before = parts(path)
    begin(client, path, what, settings)
    try:
        yield before
    finally:
        _remove(client)


def begin(client: LocalGraph, path: Path, what: Chosen, settings: dict[str, Any]) -> None:
    """Add the recorder to the graph; raises `FoveaError` when the graph refuses it."""
    _check_alone(client)
    inputs = {
        name: {"from": output.removesuffix(".out"), "depth": DEPTH}
        | ({"keep": "every"} if name in what.every else {})
        for name, output in what.inputs.items()
    }
    values = {
        **settings, "path": str(path.absolute()), "outputs": what.inputs, "graph": client.name,
        "lossless": list(what.every) if what.lossless else [], "owner_pid": os.getpid(),
    }  # fmt: skip
    node = {"operator": OPERATOR, "inputs": inputs, "settings": values}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.yaml"
        file.write_text(json.dumps({"nodes": {NODE: node}}), encoding="utf-8")
        when_free(lambda: client.add(file))


class Outcome(msgspec.Struct):
    """What became of a recording."""

    accounts: list[EdgeState] = []  # of the recorder's edges
    files: list[str] = []
    outputs: dict[str, dict[str, int]] = {}  # what the recorder counted, by node.output
    failure: str = ""  # why it could not be written to its end
    removed: bool = False  # whether another command removed the recorder


def follow(
    client: LocalGraph, path: Path, duration_s: float, asked: Callable[[], int],
    show: Callable[[list[EdgeState]], None], before: Sequence[str] = (),
) -> Outcome:  # fmt: skip
    """Wait for the duration (0: none), a signal, a failure or the end of the graph or recorder.

    Then the recorder is removed; the graph continues. `path`: as `begin` was given it; `before`:
    files beside it of other recordings.
    """
    began_s, found, looks = time.monotonic(), Outcome(files=[str(path.absolute())]), 0
    process = _look(client, found)
    while not asked() and not (duration_s and time.monotonic() - began_s >= duration_s):
        time.sleep(LOOK_S)
        looks += 1
        process = _look(client, found) or process
        if not client.runs():
            break
        if NODE not in client.nodes():
            found.removed = True
            break
        show(found.accounts)
        if looks % ASK_LOOKS == 0 and _told(client, found).failure:
            break
    if client.runs():
        _told(client, found)
        _remove(client)
    if process is not None:
        _await_end(process)
    return _ended(found, [file for file in parts(path) if file not in before])


def parts(path: Path) -> list[str]:
    """Return the files that there are of a recording, in the order in which they were begun."""
    path = path.absolute()
    numbered = {}
    for file in path.parent.glob(f"{escape(path.stem)}-*{escape(path.suffix)}"):
        number = file.stem.removeprefix(f"{path.stem}-")
        if number.isdecimal() and number.isascii():
            numbered[int(number)] = str(file)
    return [str(path)] * path.exists() + [numbered[number] for number in sorted(numbered)]


def _ended(found: Outcome, files: list[str]) -> Outcome:
    """Add what was written after the recorder was asked last, and by those that were restarted."""
    held = counted(files, found.files if found.outputs else (), found.outputs)
    if found.failure:  # it says more about the last file
        held.faults.pop(files[-1] if files else "", None)
    found.files, found.outputs = files or found.files, held.outputs
    found.failure = "; ".join([*held.faults.values(), *filter(None, [found.failure])])
    return found


def _check_alone(client: LocalGraph) -> None:
    """Raise `RunError` where the graph has a recorder, as one whose command was killed."""
    nodes = {node.name: node for node in plan_of(client).nodes}
    if NODE in nodes:
        path = harmless(str(nodes[NODE].settings.get("path", "")))
        raise RunError(
            f"{client.name}: expected no node {NODE}, got one"
            + (f", which records to {path}" if path else "")
            + f"; `fovea remove {client.name} {NODE}` ends it"
        )


def _remove(client: LocalGraph) -> None:
    """Remove the recorder, unless it or its graph has ended."""
    try:
        if client.runs() and NODE in client.nodes():
            when_free(lambda: client.remove(NODE))
    except FoveaError:
        if client.runs():
            raise


def _look(client: LocalGraph, found: Outcome) -> psutil.Process | None:
    """Take the recorder's accounts; return its process, None where it has none now."""
    with suppress(RunError, psutil.Error):
        found.accounts = accounts_of(client) or found.accounts  # none: it was removed
        facts = client.facts
        for node in facts["nodes"]:
            if node["name"] == NODE and (pid := facts["pids"].get(node["process"])):
                return psutil.Process(pid)
    return None


def _await_end(process: psutil.Process) -> None:
    """Wait for the recorder to write its end: it leaves the record of the graph before that."""
    late_s = time.monotonic() + END_S
    with suppress(psutil.Error):  # it has ended
        while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
            if time.monotonic() > late_s:
                return
            time.sleep(LOOK_S)


def _told(client: LocalGraph, found: Outcome) -> Outcome:
    """Ask the recorder for its files and failure, unless it does not answer."""
    with suppress(FoveaError):
        said = client.command(NODE, "figures", {}).answer
        found.files, found.failure = list(said["files"]), str(said["failure"])
        found.outputs = dict(said["outputs"])
    return found


def accounts_of(client: LocalGraph) -> list[EdgeState]:
    """Return the accounts of the recorder's edges."""
    states = [said for said in client.status().hosts.values() if not isinstance(said, str)]
    edges = [edge for said in states for state in said for edge in state.edges]
    return [edge for edge in edges if edge.end.startswith(f"{NODE}.")]


def _inputs() -> dict[Sent, list[str]]:
    found: dict[Sent, list[str]] = {}
    for name, port in inputs_of(load_operator(OPERATOR)).items():
        kind = Sent(port.message.__name__, codec.fingerprint(port.message).hex())
        found.setdefault(kind, []).append(name)
    return found


def _sent(client: LocalGraph, output: str) -> Sent:
    node, _, port = output.partition(".")
    client.check_node(node)
    outputs = client.ports(node).outputs
    if port not in outputs:
        options = [node if o == "out" else f"{node}.{o}" for o in outputs]
        raise RunError(f"{client.name}: {node} has no output {port}{suggest(output, options)}")
    return outputs[port]


def _full(name: str) -> str:
    return name if "." in name else f"{name}.out"
