"""The paper's tracker (MixFormerV2 exported to ONNX): look -> box and score.

The network compares two templates, the initial one and one updated at intervals, with a search
picture and returns one box. Names and sizes of inputs are those of public exports (`img_t`,
`img_ot`, `img_search` -> `pred_boxes`, `pred_scores`), factors those of the authors' settings. This
repository contains no weights for it; it is tested with networks of known output.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.tracker.following import Memory, Method
from operators.tracker.look import Streams, normalise, size_of
from operators.tracker.tracker import Tracker, TrackerSettings
from pipeline.boxes import centres, from_centres
from pipeline.errors import SettingsError, WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO, NetworkSettings

INPUTS = ("img_t", "img_ot", "img_search")
OUTPUTS = ("pred_boxes", "pred_scores")
TEMPLATE_FACTOR = 2.0  # side of a look in box sizes
SEARCH_FACTOR = 4.5
RENEW_EVERY = 200  # frames; the surest look since then becomes the second template
RENEW_SCORE = 0.5
NO_LOOK = (0, 0, 3)
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


@dataclass(frozen=True, kw_only=True)
class MixFormerTrackerSettings(TrackerSettings, NetworkSettings):
    """What a graph may set; `weights` it must."""

    weights: str  # an ONNX file
    renew_every: int = RENEW_EVERY

    def __post_init__(self) -> None:
        TrackerSettings.__post_init__(self)
        NetworkSettings.__post_init__(self)
        if self.renew_every < 1:
            raise SettingsError(f"renew_every: must be at least 1, got {self.renew_every}")


class MixFormerTracker(Tracker[MixFormerTrackerSettings]):
    """Follows with a MixFormerV2 of the user's own."""

    @classmethod
    def advise(
        cls, settings: MixFormerTrackerSettings, upstream: Mapping[str, Any]
    ) -> Iterable[str]:
        """Nothing; raises `WeightsError` for weights that are not there."""
        weights_of(settings)
        return ()

    def method(self) -> Method:
        """MixFormerV2; raises `WeightsError`."""
        s = self.settings
        return MixFormer(weights_of(s), **s.compute, renew_every=s.renew_every)


class MixFormer:
    """Follows one object; the first template stays, the second is renewed."""

    patience_score = 0.2

    def __init__(
        self, weights: Path, *, threads: int = 1, provider: str = AUTO, device: str = "",
        renew_every: int = RENEW_EVERY,
    ) -> None:  # fmt: skip
        self._network = Network(weights, threads=threads, provider=provider, device=device)
        self.provider = self._network.provider
        got = self._network.inputs, self._network.outputs
        if set(got[0]) != set(INPUTS) or set(got[1]) != set(OUTPUTS):
            raise WeightsError(
                f"{weights}: expected {', '.join(INPUTS)} -> {', '.join(OUTPUTS)}, got "
                f"{', '.join(got[0])} -> {', '.join(got[1])}"
            )
        sides = {name: _side_px(weights, name, self._network.inputs[name]) for name in INPUTS}
        self._feeds = {
            name: np.zeros((1, 3, side, side), np.float32) for name, side in sides.items()
        }
        self._template_px, self._search_px = sides["img_t"], sides["img_search"]
        self._renew_every = renew_every
        # some exports end in a sigmoid, others in its argument, as a score outside 0..1 shows
        self._logits = False
        self._begin()

    def start(self, streams: Streams, box: Box) -> None:
        """Take both templates."""
        look = self._template(streams, box)
        normalise(look, self._feeds["img_t"])
        normalise(look, self._feeds["img_ot"])
        self._begin()

    def memory(self) -> Memory:
        """Both templates, the surest look since the second, and its age and score."""
        counts = np.array([self._age, self._best], np.float32)
        return self._feeds["img_t"], self._feeds["img_ot"], self._candidate, counts

    def resume(self, memory: Memory) -> bool:
        """Take over another instance's memory."""
        shapes, templates = [part.shape for part in memory], (self._feeds[n] for n in INPUTS[:2])
        rest = [[look, (2,)] for look in ((self._template_px, self._template_px, 3), NO_LOOK)]
        if shapes[:2] != [t.shape for t in templates] or shapes[2:] not in rest:
            return False
        self._feeds["img_t"][:], self._feeds["img_ot"][:] = memory[:2]
        self._candidate = memory[2].astype(np.uint8)
        self._age, self._best = int(memory[3][0]), float(memory[3][1])
        return True

    def aligned(self, box: Box, foreseen: Box) -> Box:
        """Return the box unchanged: it is more accurate than the prediction."""
        return box

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        """Return the object's box, given the previous one, and a confidence 0..1."""
        side = SEARCH_FACTOR * size_of(box)
        normalise(streams.look(centres(box), side, self._search_px), self._feeds["img_search"])
        answers = self._network(self._feeds)
        # several boxes vote; each is centre and size in units of the look's side
        found = answers["pred_boxes"].reshape(-1, 4).mean(0)
        score = float(answers["pred_scores"].reshape(-1)[0])
        self._logits = self._logits or not 0 <= score <= 1
        score = float(1 / (1 + np.exp(-score))) if self._logits else score
        corner = centres(box) - side / 2
        now = from_centres(found[:2] * side + corner, found[2:] * side).astype(np.float32)
        self._renew(streams, now, score)
        return now, score

    def _renew(self, streams: Streams, box: Box, score: float) -> None:
        self._age += 1
        if score > self._best:
            self._best, self._candidate = score, self._template(streams, box).copy()
        if self._age >= self._renew_every:
            if self._candidate.size:
                normalise(self._candidate, self._feeds["img_ot"])
            self._begin()

    def _begin(self) -> None:
        self._age, self._best = 0, RENEW_SCORE
        self._candidate = np.zeros(NO_LOOK, np.uint8)

    def _template(self, streams: Streams, box: Box) -> NDArray[np.uint8]:
        return streams.look(centres(box), TEMPLATE_FACTOR * size_of(box), self._template_px)


def weights_of(settings: MixFormerTrackerSettings) -> Path:
    """The file to load; raises `WeightsError`."""
    path = Path(settings.weights)
    if not path.is_file():
        got = path if settings.weights else "nothing"
        raise WeightsError(f"weights: expected MixFormerV2 as an ONNX file, got {got}")
    return path


def _side_px(weights: Path, name: str, shape: list[int | str]) -> int:
    if len(shape) != 4 or shape[:2] != [1, 3] or shape[2] != shape[3]:
        raise WeightsError(f"{weights}: expected an input {name} of 1x3xSxS, got {shape}")
    if not isinstance(shape[2], int):
        raise WeightsError(f"{weights}: expected a fixed size of {name}, got {shape}")
    return shape[2]
