"""What happened, in words: instances that took over, frames that are missing, a target lost.

Everything is read off the messages themselves; the accounts of the graph come by a command.
"""

from collections.abc import Iterator

from pipeline.messages import Frame, Header, Percept

SETTLED = 5  # frames that a new state lasts before it is told
GATHERED = 30  # frames over which missing ones are told in one line
MOST_CHARS = 200  # of a line
MOST_LINES = 20  # within GATHERED frames; further ones are counted


class Changes:
    """Tells a value once it has lasted `SETTLED` times."""

    def __init__(self) -> None:
        self.value: object = None
        self._next: object = None
        self._times = 0

    def settled(self, value: object) -> bool:
        """Return whether this is a new value that has lasted long enough."""
        if value == self.value:
            self._next, self._times = None, 0
            return False
        self._times = self._times + 1 if value == self._next else 1
        self._next = value
        if self._times < SETTLED:
            return False
        self.value, self._next, self._times = value, None, 0
        return True


class Events:
    """Lines for the log, a limited number of them."""

    def __init__(self) -> None:
        self._epochs: dict[str, int] = {}  # stage -> instance
        self._newest: dict[str, int] = {}  # stage -> seq
        self.missing: dict[str, int] = {}  # stage -> frames that never arrived
        self._told: dict[str, int] = {}  # of `missing`
        self._target, self._answered, self._status = Changes(), Changes(), Changes()
        self._texts: frozenset[str] = frozenset()  # of the newest answer
        self._block, self._lines, self._kept_back = -1, 0, 0

    def arrived(self, header: Header) -> Iterator[str]:
        """Yield what a message tells by its header: another instance, frames before it missing."""
        if not header.trace:
            return
        stage, seq = header.trace[-1].stage, header.seq
        epoch = self._epochs.setdefault(stage, header.epoch)
        if header.epoch > epoch:
            self._epochs[stage] = header.epoch
            yield f"{stage}: instance {header.epoch} took over (a restart or a swap)"
        before = self._newest.setdefault(stage, seq)
        self._newest[stage] = max(before, seq)
        if seq - before > 1:
            self.missing[stage] = self.missing.get(stage, 0) + seq - before - 1
        if seq // GATHERED != before // GATHERED:
            total = self.missing.get(stage, 0)
            if fresh := total - self._told.get(stage, 0):
                self._told[stage] = total
                frames = "frame" if fresh == 1 else "frames"
                yield f"{stage}: {fresh} {frames} did not arrive here, {total} in all"

    def looked_at(self, target: str) -> Iterator[str]:
        """Yield when the target has changed; "" is a place without an object."""
        if self._target.settled(target):
            yield f"target: {target}" if target else "target: none, the policy searches"

    def answered(self, percept: Percept) -> Iterator[str]:
        """Yield when a consumer has lost its object, and when it has one again."""
        has = len(percept.boxes) > 0 or bool(percept.texts) or len(percept.action) > 0
        before = self._answered.value
        if self._answered.settled(has) and not (before is None and not has):
            yield "the consumer has its object" if has else "the consumer lost its object"

    def transcribed(self, texts: tuple[str, ...]) -> Iterator[str]:
        """Yield the texts that the answer before did not have."""
        fresh = [text for text in dict.fromkeys(texts) if text and text not in self._texts]
        self._texts = frozenset(texts)
        if fresh:
            yield f"read: {' | '.join(fresh)}"[:MOST_CHARS]

    def read(self, roi: Frame) -> Iterator[str]:
        """Yield when windows are no longer planned, come too late, or are in time again."""
        before = self._status.value
        if self._status.settled(roi.status) and (before is not None or roi.status != "ok"):
            meaning = {"unplanned": "no command covers them", "stale": "commands come too late"}
            told = meaning.get(roi.status, "commands come in time")
            yield f"ROI windows: {roi.status}, {told}"

    def allowed(self, seq: int) -> int | None:
        """Return whether one more line may be logged: None: no; else the lines that were not."""
        if seq // GATHERED != self._block:
            self._block, self._lines = seq // GATHERED, 0
        if self._lines >= MOST_LINES:
            self._kept_back += 1
            return None
        self._lines += 1
        kept_back, self._kept_back = self._kept_back, 0
        return kept_back
