"""Check operators and settings of a plan in a separate process.

An agent imports no operator: one that fails, hangs or ends its process on import affects only the
plan that names it, not the agent and its running graphs.
"""

import logging
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
from pipeline.text import harmless

INSPECT_S = 60.0  # time limit for imports and checks
LOOK_S = 0.5  # between two looks at what the process has started
PREPARED_S = 60.0  # a prepared plan may be started within this time without another inspection
log = logging.getLogger(__name__)


class NotInspected(RunError):
    """Whether a plan fits is unknown: the machine was too busy, or an import hangs."""


class Inspector:
    """Inspects plans for one host; not thread-safe."""

    def __init__(
        self, folder: Path, given_up: Callable[[], bool], reaper: Reaper | None = None
    ) -> None:
        """`folder`: for operators' output; `given_up`: whether the agent is ending."""
        self._folder, self._given_up, self._reaper = folder, given_up, reaper
        self._log = folder / "inspection.log"
        self._prepared: tuple[bytes, float, dict[str, Ports]] = b"", 0.0, {}

    def prepare(
        self, plan: Plan, fingerprints: Mapping[str, str], files: Mapping[str, str]
    ) -> None:
        """Inspect a host's part of a plan; raises `RunError`.

        `fingerprints` are those of the expected messages, by `node.output`; `files` those whose
        checksums were compared, by module.
        """
        question = self._question(plan, fingerprints, files)
        ports = self._inspect(question)
        self._prepared = encode(question), time.monotonic(), ports

    def begin(
        self, plan: Plan, fingerprints: Mapping[str, str], files: Mapping[str, str]
    ) -> dict[str, Ports]:
        """Inspect a plan before its start, unless it was prepared recently; raises `RunError`.

        Returns the ports of its operators by `module:Class`.
        """
        question = self._question(plan, fingerprints, files)
        (prepared, at_s, ports), self._prepared = self._prepared, (b"", 0.0, {})
        if prepared == encode(question) and time.monotonic() - at_s < PREPARED_S:
            return ports
        return self._inspect(question)

    def _question(
        self, plan: Plan, fingerprints: Mapping[str, str], files: Mapping[str, str]
    ) -> Inspect:
        return Inspect(plan, dict(fingerprints), dict(files), str(self._log), INSPECT_S)

    def _inspect(self, question: Inspect) -> dict[str, Ports]:
        plan = question.plan
        operators = {node.operator for node in filter(plan.is_here, plan.nodes)}
        if not operators:
            return {}
        try:
            process = spawn(
                secrets.token_hex(4), self._folder, (), wanted=True, reaper=self._reaper
            )
        except OSError as error:
            raise NotInspected(f"{plan.name}: no process can inspect it: {error}") from error
        try:
            process.channel.send(question)
            return self._answer(process, plan.name, operators)
        finally:
            process.kill()
            if not process.await_end(KILLED_S):
                log.error("process %d hangs in the kernel: it is left", process.pid)
                process.channel.close()
            process.bury()

    def _answer(self, process: NodeProcess, graph: str, operators: set[str]) -> dict[str, Ports]:
        began_s = looked_s = time.monotonic()
        names, output = ", ".join(sorted(operators)), f"its output is in {self._log}"
        while (now_s := time.monotonic()) - began_s < INSPECT_S:
            if self._given_up():
                raise RunError(f"{graph}: not inspected, this agent is ending")
            if now_s - looked_s > LOOK_S:
                looked_s = now_s
                process.look()
            status = process.ended()
            process.channel.flush()
            for event in process.channel.events():
                if isinstance(event, Failed):
                    raise RunError(harmless(event.error))
                if isinstance(event, Fits) and operators <= event.imported.ports.keys():
                    return {name: event.imported.ports[name] for name in operators}
            if status is not None:
                how = f"the process that imported {names} ended by {ending(status)}"
                raise RunError(f"{graph}: {how}; {output}")
            time.sleep(PAUSE_S)
        raise NotInspected(
            f"{graph}: {names} was not imported and checked within {INSPECT_S:.0f} s; {output}"
        )
