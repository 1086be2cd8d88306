"""Check operators and settings of a plan in a separate process.

An agent imports no operator: one that fails, hangs or ends its process on import affects only the
plan that names it, not the agent and its running graphs.
"""

import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.graph.ports import Ports
from pipeline.protocol.codec import encode
from pipeline.protocol.supervision import Failed, Fits, Inspect
from pipeline.run.process_handle import KILLED_S, PAUSE_S, NodeProcess, ending, spawn
from pipeline.run.reaper import Reaper

INSPECT_S = 60.0  # time limit for imports and checks
PREPARED_S = 60.0  # a prepared plan may be started within this time without another inspection


class Inspector:
    """Inspects plans for one host; not thread-safe."""

    def __init__(
        self, folder: Path, given_up: Callable[[], bool], reaper: Reaper | None = None
    ) -> None:
        """`folder`: for operators' output; `given_up`: whether the agent is ending."""
        self._folder, self._given_up, self._reaper = folder, given_up, reaper
        self._prepared: tuple[bytes, float, dict[str, Ports]] = b"", 0.0, {}

    def prepare(self, plan: Plan, fingerprints: Mapping[str, str]) -> dict[str, Ports]:
        """Inspect a host's part of a plan; return the ports of its operators by `module:Class`.

        `fingerprints` are those of the expected messages, by `node.output`. Raises `RunError`.
        """
        question = Inspect(plan, dict(fingerprints))
        ports = self._inspect(question)
        self._prepared = encode(question), time.monotonic(), ports
        return ports

    def begin(self, plan: Plan, fingerprints: Mapping[str, str]) -> dict[str, Ports]:
        """Inspect a plan before its start, unless it was prepared recently."""
        question, at_s, ports = self._prepared
        self._prepared = b"", 0.0, {}
        same = question == encode(Inspect(plan, dict(fingerprints)))
        if same and time.monotonic() - at_s < PREPARED_S:
            return ports
        return self._inspect(Inspect(plan, dict(fingerprints)))

    def _inspect(self, question: Inspect) -> dict[str, Ports]:
        plan = question.plan
        token = secrets.token_hex(4)
        try:
            process = spawn(token, self._folder, (), wanted=True, reaper=self._reaper)
        except OSError as error:
            raise RunError(f"{plan.name}: no process can inspect it: {error.strerror}") from error
        try:
            process.channel.send(question)
            return self._answer(process, plan)
        finally:
            process.kill()
            process.await_end(KILLED_S)
            process.bury()

    def _answer(self, process: NodeProcess, plan: Plan) -> dict[str, Ports]:
        began_s = time.monotonic()
        names = ", ".join(sorted({n.operator for n in filter(plan.is_here, plan.nodes)}))
        while time.monotonic() - began_s < INSPECT_S:
            if self._given_up():
                raise RunError(f"{plan.name}: not inspected, this agent is ending")
            status = process.ended()
            process.channel.flush()
            for event in process.channel.events():
                if isinstance(event, Fits):
                    return event.imported.ports
                if isinstance(event, Failed):
                    raise RunError(event.error)
            if status is not None:
                raise RunError(
                    f"{plan.name}: the process that imported {names} ended by {ending(status)}"
                )
            time.sleep(PAUSE_S)
        raise RunError(
            f"{plan.name}: {names} was not imported and checked within {INSPECT_S:.0f} s"
        )
