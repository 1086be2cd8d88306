"""An operator that notes where the pictures of a graph lie when they arrive."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.usb.places import Places
from pipeline import Frame, Input, Operator, SettingsError
from pipeline.whole_file import write_whole

MOST_FRAMES = 100_000  # that are written down


@dataclass(frozen=True, kw_only=True)
class WitnessSettings:
    """Where to write."""

    log: str = ""  # a file, written at the end

    def __post_init__(self) -> None:
        if not self.log:
            raise SettingsError("log: expected a file, got none")


class Witness(Operator[WitnessSettings, None]):
    """Reads every picture of the graph and writes (stream, seq, place, bytes) at the end."""

    context = Input(Frame, join=False)
    roi = Input(Frame, join=False)
    context_rgb = Input(Frame, join=False)
    roi_rgb = Input(Frame, join=False)
    small = Input(Frame, join=False)

    def open(self) -> None:
        """Start without records."""
        self._places = Places()
        self._frames: list[tuple[str, int, str, int]] = []

    def on_context(self, context: Frame) -> None:
        """Note a raw context."""
        self._note("context", context)

    def on_roi(self, roi: Frame) -> None:
        """Note a raw ROI."""
        self._note("roi", roi)

    def on_context_rgb(self, context_rgb: Frame) -> None:
        """Note a developed context."""
        self._note("context_rgb", context_rgb)

    def on_roi_rgb(self, roi_rgb: Frame) -> None:
        """Note a developed ROI."""
        self._note("roi_rgb", roi_rgb)

    def on_small(self, small: Frame) -> None:
        """Note what the detector gets."""
        self._note("small", small)

    def close(self) -> None:
        """Write the records."""
        frames: list[Any] = getattr(self, "_frames", [])
        write_whole(Path(self.settings.log), json.dumps(frames))

    def _note(self, stream: str, frame: Frame) -> None:
        if len(self._frames) < MOST_FRAMES:
            place = self._places.of(frame.pixels.ctypes.data)
            self._frames.append((stream, frame.header.seq, place, frame.pixels.nbytes))
