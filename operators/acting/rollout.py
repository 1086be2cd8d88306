"""Closed-loop trials of the frozen consumer for training: a seed in, what each window gained out.

The gain of a window is the change of the consumer's chunk against full resolution with what it
already knows, less that with the window on top. It needs no labels.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.readout import average, geometry_of, scaled
from drivers.scenes.insertion import COMPLETE, STEPS, InsertionScene
from operators.acting.looked import Looked, followed, nothing_looked, shown
from operators.acting.windows import Array, Candidates, Region, appearance, candidates, facts
from operators.association import Association, AssociationSettings
from operators.manipulation.ensemble import Ensemble
from operators.manipulation.manipulation import SHIPPED, ActionChunkingSettings
from operators.manipulation.memory import SharpMemory
from operators.manipulation.network import ActNetwork
from operators.manipulation.picture import WORKPLACE, place
from operators.manipulation.utility import NOTHING, Acquisition, Window, view
from operators.saliency import Saliency, SaliencySettings
from pipeline import Frame, Geometry, Header, Tracks

ROI_AREA = 0.0625
CHANGE_LEVELS = ActionChunkingSettings.change_levels
FULL = Acquisition(context_scale=1.0)
Choose = Callable[["Moment"], int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """What the policy knows after a frame."""

    step: int
    candidates: Candidates
    facts: Array  # (n, FACTS)
    appearance: Array  # (n, channels)
    joints: Array  # (14,)


@dataclass(frozen=True, kw_only=True, eq=False)
class Valued:
    """A moment, and the gain (n,) of each window, of which those not tried are NaN."""

    moment: Moment
    gains: Array
    change: float  # of the chunk as it was, against full resolution


class Trial:
    """One trial, frame by frame; the context and the ROI are those of a sixteenth of the pixels."""

    def __init__(
        self, seed: int, *, consumer: Path = SHIPPED, workplace: Region = WORKPLACE,
        saliency: SaliencySettings, association: AssociationSettings,
    ) -> None:  # fmt: skip
        self._scene = InsertionScene(seed=seed)
        self.geometry = geometry_of(self._scene.size_px, roi_area=ROI_AREA)
        self._net, self._how, self._workplace = ActNetwork(consumer), Acquisition(), workplace
        self._memory = SharpMemory(CHANGE_LEVELS)
        self._ensemble = Ensemble(ActionChunkingSettings.decay)
        self._saliency, self._association = Saliency(saliency), Association(association)
        self._saliency.open()
        self._association.open()
        self._looked: Looked = nothing_looked()
        self.best = 0

    def close(self) -> None:
        """Release the renderer and the networks."""
        self._scene.close()
        self._saliency.close()

    def moments(
        self, choose: Choose, random: np.random.Generator, *, every: int, tried: int
    ) -> list[Valued]:
        """Return every `every`-th moment of the trial with the gains of up to `tried` windows."""
        found = []
        window: Window = _middle(self.geometry)
        offset = int(random.integers(every))
        for step in range(STEPS):
            picture, joints = self._scene.picture(step), self._scene.joints()[0]
            tracks = self._seen(step, picture, window)
            told = self._net(self._shown(picture, window, self._memory), joints)
            windows = candidates(tracks, self._workplace)
            moment = Moment(
                step=step,
                candidates=windows,
                facts=facts(tracks, self._looked, windows, step),
                appearance=appearance(tracks, windows),
                joints=joints,
            )
            if step % every == offset:
                found.append(self._valued(moment, picture, told, random, tried))
            row = choose(moment)
            window = _whole(windows.windows[row])
            self._ensemble.add(step, told)
            self._scene.act(step, self._ensemble.targets(step, 1))
            self.best = self._scene.outcome()[0]
            if self.best == COMPLETE:
                break
        return found

    def _seen(self, step: int, picture: NDArray[np.uint8], window: Window) -> Tracks:
        """Return the tracks of a frame, and note what its ROI showed."""
        height, width = picture.shape[:2]
        sides = scaled((width, height), self._how.context_scale)
        context = np.empty((sides[1], sides[0], 3), np.uint8)
        average(picture, context)
        header = Header(stream="trial", seq=step, stamp_ns=step, geometry=self.geometry)
        frame = Frame(header=header, pixels=context, window=(0, 0, width, height))
        self._looked = followed(self._looked, context, CHANGE_LEVELS)
        self._looked = shown(self._looked, context, window, self.geometry, step)
        detections = self._saliency.on_frame(frame)
        return self._association.on_detections(detections)

    def _shown(
        self, picture: NDArray[np.uint8], window: Window, memory: SharpMemory
    ) -> NDArray[np.uint8]:
        """Return what the consumer sees, and keep it in a memory."""
        net = self._net
        context = view(net, picture, NOTHING, self._how)
        covered = np.zeros_like(context)
        field = picture.shape[1], picture.shape[0]
        place(np.full((1, 1, 3), 255, np.uint8), window, field, covered, net.workplace)
        return memory.add(context, view(net, picture, window, self._how), covered[..., 0] > 0)

    def _valued(
        self, moment: Moment, picture: NDArray[np.uint8], told: Array,
        random: np.random.Generator, tried: int,
    ) -> Valued:  # fmt: skip
        net, joints = self._net, moment.joints
        wanted = net(view(net, picture, NOTHING, FULL), joints)
        change = float(np.abs(told - wanted).mean())
        windows = moment.candidates.windows
        gains = np.full(len(windows), np.nan, np.float32)
        for row in random.permutation(len(windows))[:tried]:
            seen = self._shown(picture, _whole(windows[row]), deepcopy(self._memory))
            gains[row] = change - np.abs(net(seen, joints) - wanted).mean()
        return Valued(moment=moment, gains=gains, change=change)


def _whole(window: Array) -> Window:
    left, top, right, bottom = (int(side) for side in window)
    return left, top, right, bottom


def _middle(geometry: Geometry) -> Window:
    left = geometry.aligned((geometry.width_px - geometry.roi_width_px) // 2)
    top = geometry.aligned((geometry.height_px - geometry.roi_height_px) // 2)
    return left, top, left + geometry.roi_width_px, top + geometry.roi_height_px
