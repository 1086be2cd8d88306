"""What the nodes of a run tell of themselves: headlines while they run, summaries at the end."""

import logging
from typing import Any

from pipeline.protocol.supervision import Event, Headline, Summary
from pipeline.run.process_handle import ProcessHandle
from pipeline.text import harmless, plain

MOST_HEADLINE = 200  # characters
log = logging.getLogger(__name__)


class NodeReports:
    """The newest word of every node."""

    def __init__(self) -> None:
        self.summaries: dict[str, dict[str, Any]] = {}
        self.left_out: dict[str, str] = {}  # by node: what the report lacks of its summary
        self.headlines: dict[str, str] = {}
        self._summed: dict[str, int] = {}  # the process whose summary is kept, by node

    def note(self, handle: ProcessHandle, event: Event, *, present: bool) -> None:
        """Keep what a process tells; a headline only of the `present` process of its nodes."""
        if isinstance(event, Summary) and event.node in handle.nodes:
            self._keep_summary(handle, event)
        elif isinstance(event, Headline) and event.node in handle.nodes and present:
            self.headlines[event.node] = harmless(event.words, MOST_HEADLINE)

    def _keep_summary(self, handle: ProcessHandle, event: Summary) -> None:
        """Keep that of the newest process, which a source sends in two parts."""
        node = event.node
        if self._summed.get(node) != handle.pid:
            self._summed[node], self.summaries[node] = handle.pid, {}
            self.left_out.pop(node, None)
        if event.left_out:
            self.left_out[node] = harmless(event.left_out)
            log.warning("%s: its summary is left out: %s", node, self.left_out[node])
        self.summaries[node].update(plain(event.figures))
