"""Live settings and commands: frames in, nothing out; commands return the brightness.

fovea run examples/meter
fovea set meter meter alarm_above=50           (in another terminal)
fovea tell meter meter brightest count=3
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fovea import Frame, Input, MessageError, Operator, SettingsError

KEPT = 1000  # frames; bounded, since a graph may run for weeks


@dataclass(frozen=True, kw_only=True)
class MeterSettings:
    """What a graph may set."""

    alarm_above: float = 255.0  # mean of a frame

    def __post_init__(self) -> None:
        if self.alarm_above < 0:
            raise SettingsError(f"alarm_above: must be at least 0, got {self.alarm_above}")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The counts, for a successor."""

    frames: int
    alarms: int
    means: tuple[float, ...]
    seqs: tuple[int, ...]


class Meter(Operator[MeterSettings, None]):
    """Measure the mean brightness of every frame; count those above a limit."""

    live = ("alarm_above",)  # `fovea set` may change it; the new settings are in `self.settings`
    commands = ("brightest", "forget")  # `fovea tell` calls do_brightest, do_forget

    frame = Input(Frame, keep="latest")

    def open(self) -> None:
        """Start with empty counts."""
        self._kept: deque[tuple[float, int]] = deque(maxlen=KEPT)  # mean and seq
        self._frames = self._alarms = 0

    def on_frame(self, frame: Frame) -> None:
        """Measure one frame; there is no output. Raises `MessageError` for packed pixels."""
        if frame.packed:
            raise MessageError(f"meter: expected a number per sample, got {frame.pixel_format}")
        mean = float(frame.pixels.mean())
        self._kept.append((mean, frame.header.seq))
        self._frames += 1
        self._alarms += mean > self.settings.alarm_above

    def state(self) -> Measured:
        """Return the counts for a successor."""
        means, seqs = [mean for mean, _ in self._kept], [seq for _, seq in self._kept]
        return Measured(
            frames=self._frames, alarms=self._alarms, means=tuple(means), seqs=tuple(seqs)
        )

    def restore(self, state: Measured) -> None:
        """Take over the counts of another instance."""
        self._kept.extend(zip(state.means, state.seqs, strict=True))
        self._frames, self._alarms = state.frames, state.alarms

    def do_brightest(self, count: int = 1) -> Mapping[str, Any]:
        """Return seq and mean of the brightest of the last frames."""
        if count < 1:
            raise SettingsError(f"brightest.count: must be at least 1, got {count}")
        found = sorted(self._kept, reverse=True)[:count]
        return {"frames": [seq for _, seq in found], "means": [round(mean, 2) for mean, _ in found]}

    def do_forget(self) -> None:
        """Reset the counts."""
        self.open()

    def headline(self) -> str:
        """Return a few words for the status line of `fovea run`."""
        return f"alarms {self._alarms}"

    def summary(self) -> Mapping[str, Any]:
        """Return figures for the report of the run."""
        return {
            "headline": f"{self._alarms} of {self._frames} frames were too bright",
            "brightness": {"frames": self._frames, "alarms": self._alarms},
        }
