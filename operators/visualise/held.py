"""What is drawn of a frame, held until all of it is there.

Tracks and commands of a frame come after its picture. Drawn as they come, the boxes in a live view
would lie where things were some frames ago.
"""

from collections.abc import Iterator
from typing import Generic, TypeVar

MOST_FRAMES = 8  # held; of a source further behind nothing is waited for
T = TypeVar("T")


class Held(Generic[T]):
    """Items by frame and source; each source brings its frames in order, perhaps not all."""

    def __init__(self) -> None:
        self._items: dict[int, list[T]] = {}  # by frame
        self._newest: dict[str, int] = {}  # source -> frame
        self._head = -1

    def arrived(self, frame: int, source: str) -> None:
        """Take note that a source has come to this frame, whatever it has to draw."""
        self._newest[source] = max(frame, self._newest.get(source, frame))
        self._head = max(self._head, frame)

    def add(self, frame: int, item: T) -> None:
        """Hold an item of a frame."""
        self._items.setdefault(frame, []).append(item)

    def complete(self) -> Iterator[tuple[int, list[T]]]:
        """Yield the frames that no source will add to, in order, and hold them no longer."""
        behind = self._head - MOST_FRAMES
        until = min((k for k in self._newest.values() if k > behind), default=self._head)
        return self._taken(max(until, behind))

    def all(self) -> Iterator[tuple[int, list[T]]]:
        """Yield every frame, in order; sources may begin anew."""
        yield from self._taken(self._head)
        self._newest, self._head = {}, -1

    def _taken(self, until: int) -> Iterator[tuple[int, list[T]]]:
        for frame in sorted(k for k in self._items if k <= until):
            yield frame, self._items.pop(frame)
