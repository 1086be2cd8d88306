"""A client of the nodes of a graph that runs on this host, over the graph's own bus."""

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager

from pipeline.bus.session import Session
from pipeline.errors import RunError
from pipeline.node.wiring import key_of
from pipeline.protocol.codec import encode
from pipeline.protocol.questions import KEYS, NodeQuestion
from pipeline.run.rundir import folder_of

TIMEOUT_S = 5.0  # a node answers between two frames; one that hangs does not
_COUNT = itertools.count()  # several threads may ask


def ask_local(folder: str, graph: str, node: str, question: NodeQuestion) -> bytes:
    """The answer of a node of a graph that runs in a folder of that name, or its refusal.

    Raises `RunError` for silence.
    """
    with client_session(folder, "ask") as session:
        key = key_of(graph, node, KEYS[type(question)])
        answer = session.ask(key, encode(question), TIMEOUT_S)
    if answer is None:
        raise RunError(
            f"{folder}: {node} gave no answer for {TIMEOUT_S:.0f} s; "
            f"see `fovea logs {folder} {node}`"
        )
    return answer


@contextmanager
def client_session(graph: str, purpose: str) -> Iterator[Session]:
    """A session on the bus of a graph that runs here; it leaves no file, not even when killed."""
    own = f"{purpose}-{os.getpid()}-{next(_COUNT)}"
    session = Session(folder_of(graph), own, timeout_s=1.0, guest=True)
    try:
        yield session
    finally:
        session.close()
