"""Operators that declare their state in ways that a swap cannot carry, and one that keeps some."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pipeline import Frame, Input, Operator
from tests.samples import WorkSettings

if TYPE_CHECKING:
    from tests.samples import TallyState as Elsewhere


@dataclass(frozen=True, kw_only=True)
class Counted:
    """A number of frames."""

    count: int


class Forgetful(Operator[WorkSettings, Frame]):
    """Counts frames without declaring a state; its table never changes."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.table = {"gain": [1, 2, 3]}
        self.seen = 0
        self.recent: list[int] = []

    def on_frame(self, frame: Frame) -> Frame:
        self.seen += 1
        self.recent.append(frame.header.seq)
        return frame


class Counter(Forgetful):
    """Counts frames and declares its state."""

    def state(self) -> Counted:
        return Counted(count=self.seen)

    def restore(self, state: Counted) -> None:
        self.seen = state.count


@dataclass(frozen=True, kw_only=True)
class Recount:
    """What `Counted` has become."""

    frames: int
    last_seq: int = -1


class Recounted(Forgetful):
    """Declares a state that is not what its predecessor wrote."""

    def state(self) -> Recount:
        return Recount(frames=self.seen)

    def restore(self, state: Recount) -> None:
        self.seen = state.frames


class Unnamed(Counter):
    """Declares a state without naming its type."""

    def state(self):  # type: ignore[no-untyped-def,override]
        return Counted(count=self.seen)


class Unresolved(Counter):
    """Declares a state whose type only type checkers can resolve."""

    def state(self) -> "Elsewhere":  # type: ignore[override]
        return Counted(count=self.seen)  # type: ignore[return-value]


class Unrestored(Forgetful):
    """Declares a state and has no `restore`."""

    def state(self) -> Counted:
        return Counted(count=self.seen)


class Refusing(Counter):
    """Fails to restore its own state."""

    def restore(self, state: Counted) -> None:
        raise ValueError(f"{state.count} is too many" if state.count >= 0 else "")


class Mistaken(Counter):
    """Returns a state that does not match its declared type."""

    def state(self) -> Counted:
        return Counted(count="many")  # type: ignore[arg-type]


class Loose(Counter):
    """Returns a state that is no dataclass."""

    def state(self) -> Any:
        return {"count": self.seen}
