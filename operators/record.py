"""Record outputs of a running graph: any messages -> MCAP files.

`fovea record` adds it to a running graph; a graph may also hold it as a manual node. Its inputs are
taps, named by type and number; the edge says which output an input records. The handlers only
queue, a thread writes. In real time the graph waits for neither: what there is no room for is
dropped and counted.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import psutil

from pipeline.client.local import LocalGraph
from pipeline.client.recording import NODE
from pipeline.contract import HEADLINE, INCOMPLETE, Input, Operator
from pipeline.errors import FoveaError, RunError, SettingsError
from pipeline.messages import (
    Detections,
    Frame,
    Message,
    Percept,
    RoiFeatures,
    RoiSchedule,
    Scanpath,
    Tracks,
    Truth,
)
from pipeline.node.live import kept
from pipeline.recording.recorder import Limits, Recorder, total
from pipeline.run.rundir import folder_of, running
from pipeline.version import described

INPUTS = {  # by type: how many outputs of it can be recorded
    Frame: 10,
    Detections: 3,
    Tracks: 3,
    RoiFeatures: 3,
    Scanpath: 3,
    RoiSchedule: 3,
    Percept: 6,
    Truth: 3,
}
ASK_S = 1.0  # between two looks at the graph
LIVE_S = 0.1  # between two looks at the files of settings that were changed
SETTINGS_LOOKS = 10  # every so many of them, the nodes are asked for their settings


@dataclass(frozen=True, kw_only=True)
class RecordSettings:
    """What a graph may set. Limits of 0 are none."""

    path: str = ""  # of the .mcap file; further files are PATH-2.mcap, PATH-3.mcap …
    outputs: Mapping[str, str] = field(default_factory=dict)  # input -> node.output
    lossless: tuple[str, ...] = ()  # in lockstep: wait for room in the queue rather than drop
    graph: str = ""  # the running graph whose plan, settings, accounts and events are recorded
    file_mb: float = 0.0  # begin a new file at this size
    file_s: float = 0.0  # and after this time
    ring_s: float = 0.0  # keep the last seconds in memory, write them when told to
    ring_mb: float = 256.0  # at most so much of them
    lost_frames: int = 0  # also write the ring when percepts had no box for so many frames
    queue_mb: float = 256.0  # of messages that wait to be written
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_s: float = 0.5  # what a killed recorder loses at most
    owner_pid: int = 0  # of the command that added it: it leaves the graph when that has ended

    def __post_init__(self) -> None:
        for name in ("file_mb", "file_s", "ring_s"):
            if not 0 <= getattr(self, name) < 1e9:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if self.lost_frames < 0 or (self.lost_frames and not self.ring_s):
            raise SettingsError(f"lost_frames: needs ring_s above 0, got {self.lost_frames}")
        if self.owner_pid < 0:
            raise SettingsError(f"owner_pid: must be at least 0, got {self.owner_pid}")
        for name in ("ring_mb", "queue_mb", "chunk_s"):
            if not 0 < getattr(self, name) < 1e9:
                raise SettingsError(f"{name}: must be above 0, got {getattr(self, name)}")

    def limits(self) -> Limits:
        """Return the limits in bytes."""
        return Limits(
            chunk_s=self.chunk_s, file_bytes=int(self.file_mb * 1e6), file_s=self.file_s,
            ring_s=self.ring_s, ring_bytes=int(self.ring_mb * 1e6),
            queue_bytes=int(self.queue_mb * 1e6), compression=self.compression,
        )  # fmt: skip


class Record(Operator[RecordSettings, None]):
    """Records its inputs. An input without an entry in `outputs` is recorded by its own name.

    Messages of your own types: subclass it and declare an input for each.
    """

    commands = ("write", "figures")
    recorder_type: ClassVar[type[Recorder]] = Recorder

    _recorder: Recorder | None = None
    _watch: "_Watch | None" = None
    _over = False  # whether the recorder was closed

    def open(self) -> None:
        """Begin the first file; raises `RunError` when it cannot be made."""
        s = self.settings
        if not s.path:  # not in the settings: of a deployed graph, the host's file may set it
            raise SettingsError("path: expected a file to write, got none")
        self._empty: dict[str, int] = {}  # frames without a box, by output
        self._recorder = self.recorder_type(Path(s.path).absolute(), s.limits())
        self._recorder.note("graph", {"version": described(), "name": s.graph})
        if s.graph:
            self._watch = _Watch(s.graph, self._recorder, s.owner_pid)

    def state(self) -> None:
        """Return None: another instance begins another file."""

    def do_write(self, why: str = "asked for") -> dict[str, Any]:
        """Write what the ring holds."""
        if not self.settings.ring_s:
            raise RunError("record: expected ring_s above 0, got a recorder that writes everything")
        self._out.dump(why)
        return {"ring_s": self.settings.ring_s}

    def do_figures(self) -> dict[str, Any]:
        """Return files, counts by output, and why nothing more can be written (empty: it can)."""
        files = [str(path) for path in self._out.files]
        return {"files": files, "outputs": self._out.figures(), "failure": self._out.failure}

    def headline(self) -> str:
        """Return the messages so far."""
        if self._recorder is None:
            return ""
        return f"recorded {total(self._recorder.figures()).get('recorded', 0)}"

    def summary(self) -> Mapping[str, Any]:
        """End the recording; return its files and counts."""
        recorder, failure = self._recorder, self._ended()
        if recorder is None:
            return {}
        figures = recorder.figures()
        counts = total(figures)
        files = [str(path) for path in recorder.files]
        place = f" to {', '.join(files[:3])}" if files else ""  # a ring may never be written
        passed = f", {counts['passed']} passed through the ring" if counts.get("passed") else ""
        found: dict[str, Any] = {
            "files": files, "outputs": figures,
            HEADLINE: f"recorded {counts.get('recorded', 0)} messages{place}, dropped "
            f"{counts.get('dropped', 0)}{passed}",
        }  # fmt: skip
        return {**found, INCOMPLETE: failure} if failure else found

    def close(self) -> None:
        """End the file; raises `RunError` if messages were lost at its end."""
        if failure := self._ended():
            raise RunError(failure)

    def take(self, name: str, message: Message) -> None:
        """Queue a message of an input."""
        s, output = self.settings, self.settings.outputs.get(name, name)
        self._out.add(output, message, wait=name in s.lossless)
        if s.lost_frames and isinstance(message, Percept):
            empty = self._empty.get(output, s.lost_frames)  # nothing is lost before it was found
            empty = 0 if len(message.boxes) else empty + 1
            self._empty[output] = empty
            if empty == s.lost_frames:
                self._out.dump(f"{output}: frame {message.header.seq}: the target was lost")

    def _ended(self) -> str:
        if self._watch is not None:
            self._watch.close()
            self._watch = None
        if self._recorder is None:
            return ""
        failure = "" if self._over else self._recorder.close()
        self._over = True
        return failure

    @property
    def _out(self) -> Recorder:
        if self._recorder is None:
            raise RunError("record: expected to be open, got a message before that")
        return self._recorder


def _handler(name: str) -> Callable[..., None]:
    def handle(self: Record, **messages: Message) -> None:
        self.take(name, messages[name])

    return handle


for _message, _count in INPUTS.items():
    for _number in range(1, _count + 1):
        _name = f"{_message.__name__.lower()}_{_number}"
        setattr(Record, _name, Input(_message, join=False, optional=True, tap=True))
        setattr(Record, f"on_{_name}", _handler(_name))


class _Watch:
    """Records what becomes of the graph: its plan, settings, accounts, swaps and restarts."""

    def __init__(self, graph: str, recorder: Recorder, owner_pid: int = 0) -> None:
        self._graph, self._recorder, self._owner_pid = graph, recorder, owner_pid
        self._plan: Any = None
        self._nodes: dict[str, tuple[str, int]] = {}
        self._live, self._looking = _LiveFiles(folder_of(graph)), threading.Lock()
        self._stopped = threading.Event()
        self._look(0)
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End; do not wait for a graph that does not answer: the recording is to be closed."""
        self._stopped.set()
        self._note_changes()  # those since the last look, also while the graph is being asked
        self._thread.join(ASK_S)

    def _run(self) -> None:
        looks, asked_s = 0, time.monotonic()
        while not self._stopped.wait(LIVE_S):
            self._note_changes()
            if time.monotonic() - asked_s >= ASK_S:
                looks, asked_s = looks + 1, time.monotonic()
                self._look(looks)
                if self._owner_pid and not psutil.pid_exists(self._owner_pid):
                    self._leave()

    def _leave(self) -> None:
        """Leave the graph: who was killed can end no recording, which would fill the disk."""
        with suppress(FoveaError, OSError):  # the next look tries again
            facts = running().get(self._graph)
            if facts is not None:
                LocalGraph(self._graph, facts).remove(NODE)

    def _note_changes(self) -> None:
        with self._looking:
            for node, values, at_ns in self._live.changes(self._planned()):
                event = {"event": "set", "node": node, "settings": values, "at_ns": at_ns}
                self._recorder.note("events", event, at_ns)

    def _planned(self) -> dict[str, dict[str, Any]]:
        """Return the settings of each node by the plan."""
        return {node["name"]: node["settings"] for node in (self._plan or {}).get("nodes", ())}

    def _look(self, looks: int) -> None:
        try:
            facts = running().get(self._graph)
            if facts is None:
                return
            if facts["plan"] != self._plan:
                self._plan = facts["plan"]
                known = {"name": self._graph, "version": described(), "plan": self._plan}
                self._recorder.note("graph", {**known, "revision": facts["revision"]})
            client = LocalGraph(self._graph, facts)
            (states,) = client.status().hosts.values()
            assert not isinstance(states, str)
            self._recorder.note("accounts", {"states": states})
            self._compare({n.name: ("epoch", n.epoch) for s in states for n in s.nodes})
            if looks % SETTINGS_LOOKS == 1:
                self._ask_settings(client)
        except (FoveaError, OSError, ValueError):
            return  # the graph is starting or ending; the next look may succeed

    def _compare(self, nodes: dict[str, tuple[str, int]]) -> None:
        """Note which nodes came, went, or were swapped or restarted."""
        for name in nodes.keys() | self._nodes.keys():
            now, before = nodes.get(name), self._nodes.get(name)
            if self._nodes and now != before:
                what = "removed" if now is None else "added" if before is None else "new instance"
                epoch = now[1] if now else 0
                self._recorder.note("events", {"event": what, "node": name, "epoch": epoch})
        self._nodes = nodes

    def _ask_settings(self, client: LocalGraph) -> None:
        found = {}
        for name in client.nodes():
            if self._stopped.is_set():
                return
            try:
                found[name] = client.configure(name, {}).settings
            except FoveaError:
                continue  # it is busy; its settings in the plan are known
        self._recorder.note("settings", found)


class _LiveFiles:
    """The files in which the nodes of this host keep the settings that `fovea set` changed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[str, tuple[int, dict[str, Any]]] = {}
        list(self.changes({}))  # what was set before

    def changes(
        self, planned: Mapping[str, Mapping[str, Any]]
    ) -> Iterator[tuple[str, dict[str, Any], int]]:
        """Yield node, changed settings and the time of the change, in ns of the wall clock.

        A node's first file also holds what it was `planned` with.
        """
        for file in sorted(self._folder.glob("*.live")):
            try:
                at_ns = file.stat().st_mtime_ns
            except OSError:
                continue  # the graph is ending
            before_ns, known = self._known.get(file.stem, (0, {}))
            if at_ns == before_ns:
                continue
            values, before = kept(file), {**planned.get(file.stem, {}), **known}
            self._known[file.stem] = at_ns, values
            changed = {k: v for k, v in values.items() if k not in before or before[k] != v}
            if changed:
                yield file.stem, changed, at_ns
