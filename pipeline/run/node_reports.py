"""Collect what the nodes report: headlines while they run, summaries at the end."""

import logging
from typing import Any

from pipeline.protocol.supervision import Event, Headline, Summary
from pipeline.run.process_handle import ProcessHandle
from pipeline.text import harmless, plain

MOST_HEADLINE = 200  # characters
log = logging.getLogger(__name__)


class NodeReports:
    """The latest headline and summary of every node."""

    def __init__(self) -> None:
        self.summaries: dict[str, dict[str, Any]] = {}
        self.left_out: dict[str, str] = {}  # by node: why its summary is missing
        self.headlines: dict[str, str] = {}
        self._summed: dict[str, int] = {}  # by node: the process whose summary is stored

    def note(self, handle: ProcessHandle, event: Event, *, present: bool) -> None:
        """Store an event; a headline only from the current process of the node (`present`)."""
        if isinstance(event, Summary) and event.node in handle.nodes:
            self._keep_summary(handle, event)
        elif isinstance(event, Headline) and event.node in handle.nodes and present:
            self.headlines[event.node] = harmless(event.words, MOST_HEADLINE)

    def _keep_summary(self, handle: ProcessHandle, event: Summary) -> None:
        """Store the summary of the latest process; a source sends it in two parts."""
        node = event.node
        if self._summed.get(node) != handle.pid:
            self._summed[node], self.summaries[node] = handle.pid, {}
            self.left_out.pop(node, None)
        if event.left_out:
            self.left_out[node] = harmless(event.left_out)
            log.warning("%s: its summary is incomplete: %s", node, self.left_out[node])
        self.summaries[node].update(plain(event.figures))
