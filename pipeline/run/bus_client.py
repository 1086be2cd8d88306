"""Ask nodes of a graph on this host, over the graph's own bus."""

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
_COUNT = itertools.count()  # makes names unique, also across threads


def ask_local(folder: str, graph: str, node: str, question: NodeQuestion) -> bytes:
    """Return the reply of a node, for the run folder of its graph.

    Raises `RunError` after the timeout.
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
    """Yield a session on the bus of a local graph; it leaves no file, even when killed."""
    own = f"{purpose}-{os.getpid()}-{next(_COUNT)}"
    session = Session(folder_of(graph), own, timeout_s=1.0, guest=True)
    try:
        yield session
    finally:
        session.close()
