"""Whether operators and settings of a plan fit, found out by a process of its own.

An agent imports no operator: one that breaks, hangs or ends its process when it is imported costs
the plan that names it, not the agent and the graphs that run.
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

INSPECT_S = 60.0  # for the imports and the checks
PREPARED_S = 60.0  # so long what was prepared may be started without another inspection


class Inspector:
    """Inspects plans for one host. For one thread."""

    def __init__(
        self, folder: Path, given_up: Callable[[], bool], reaper: Reaper | None = None
    ) -> None:
        """`folder`: for what operators print; `given_up`: the host ends, nobody needs an answer."""
        self._folder, self._given_up, self._reaper = folder, given_up, reaper
        self._prepared: tuple[bytes, float, dict[str, Ports]] = b"", 0.0, {}

    def prepare(self, plan: Plan, fingerprints: Mapping[str, str]) -> dict[str, Ports]:
        """Inspect a host's part of a plan; returns the ports of its operators by `module:Class`.

        `fingerprints` are of the messages that are meant, by `node.output`. Raises `RunError`.
        """
        question = Inspect(plan, dict(fingerprints))
        ports = self._inspect(question)
        self._prepared = encode(question), time.monotonic(), ports
        return ports

    def begin(self, plan: Plan, fingerprints: Mapping[str, str]) -> dict[str, Ports]:
        """Likewise, before it is started: what was prepared just now is not inspected again."""
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
                raise RunError(f"{plan.name}: not inspected, this host ends")
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
