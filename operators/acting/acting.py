"""A policy for a consumer that acts: Tracks, context, ROI and joints -> Scanpath.

A network tells of each window what showing it would change in the consumer's actions, given where
the ROI looked before and what has changed since. A rule stands beside it: the windows of the
workplace in turn.
"""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.robot import Joints
from operators.acting.looked import Looked, followed, nothing_looked, shown
from operators.acting.network import SHIPPED, ActingNetwork
from operators.acting.windows import Array, appearance, candidates, facts, in_turn
from pipeline import Frame, Header, Input, MessageError, Operator, Scanpath, SettingsError, Tracks
from pipeline.providers import NetworkSettings

log = logging.getLogger(__name__)
Choice = Literal["gain", "turn"]
NO_TRACK = -1  # a choice that is a place
MOST_AHEAD = 64


@dataclass(frozen=True, kw_only=True)
class ActingPolicySettings(NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file of operators.acting.train; empty: the shipped one
    choose: Choice = "gain"  # the window that gains most, or those of the workplace in turn
    workplace: tuple[float, float, float, float] = (0.2, 0.36667, 0.8, 0.76667)  # xyxy, shares of
    # the field: what is looked at where no object is seen
    change_levels: float = 6.0  # of 255, between contexts, over which a part must be shown anew
    horizon: int = 4  # Tp, frames planned

    def __post_init__(self) -> None:
        super().__post_init__()
        left, top, right, bottom = self.workplace
        if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
            raise SettingsError(
                f"workplace: expected four shares of the field, xyxy, got {list(self.workplace)}"
            )
        if not 0 <= self.change_levels <= 255:
            raise SettingsError(f"change_levels: expected 0 to 255, got {self.change_levels}")
        if not 1 <= self.horizon <= MOST_AHEAD:
            raise SettingsError(f"horizon: expected 1 to {MOST_AHEAD}, got {self.horizon}")


class ActingPolicy(Operator[ActingPolicySettings, Scanpath]):
    """Always proposes windows: those of the workplace where nothing is tracked."""

    tracks = Input(Tracks, keep="every")
    context = Input(Frame)
    roi = Input(Frame)
    joints = Input(Joints)

    @classmethod
    def advise(cls, settings: ActingPolicySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `WeightsError` for a network that is none of these."""
        network_of(settings)
        return ()

    def open(self) -> None:
        """Load the network; raises `WeightsError`."""
        self._network = network_of(self.settings)
        self._looked = nothing_looked()

    def on_stream(self, header: Header) -> None:
        """Forget what was shown of another stream."""
        self._looked = nothing_looked()

    def state(self) -> Looked:
        """Return what was shown."""
        return self._looked

    def restore(self, state: Looked) -> None:
        """Take over what another instance has shown."""
        self._looked = state

    def summary(self) -> dict[str, str]:
        """What the network runs on."""
        return self._network.where() if self._network else {}

    def headline(self) -> str:
        """What the network runs on, unless it is the CPU."""
        return self._network.headline() if self._network else ""

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._network.provider if self._network else ""

    def on_tracks_context_roi_joints(
        self, tracks: Tracks, context: Frame, roi: Frame, joints: Joints
    ) -> Scanpath:
        """Plan the frames after this one."""
        seq, geometry = tracks.header.seq, tracks.header.geometry
        if context.pixels.size:
            if context.pixel_format != "rgb8":
                raise MessageError(
                    f"policy.context: expected rgb8 pixels, got {context.pixel_format}; put "
                    "operators.downsample:Downsample before it"
                )
            pixels = np.asarray(context.pixels, np.uint8)
            self._looked = followed(self._looked, pixels, self.settings.change_levels)
            if roi.pixels.size:
                self._looked = shown(self._looked, pixels, roi.window, geometry, seq)
        sound = finite(tracks)
        windows, choice = self._plan(sound, joints)
        return Scanpath(
            header=tracks.header,
            ids=sound.ids,
            probability=(choice[:, None] == sound.ids[None]).astype(np.float32),
            choice=choice,
            boxes=windows,
            first_seq=seq + 1,
        )

    def _plan(self, tracks: Tracks, joints: Joints) -> tuple[Array, np.ndarray]:
        """Return windows (Tp, 4) and tracks (Tp,); a frame counts what those before will show."""
        s, looked, seq = self.settings, self._looked, tracks.header.seq
        found = candidates(tracks, s.workplace)
        looks = appearance(tracks, found)
        windows, choice = [], []
        for step in range(1, s.horizon + 1):
            if self._network:
                known = facts(tracks, looked, found, seq + step - 1)
                best = int(self._network(known, looks, joints.positions).argmax())
            else:
                best = in_turn(found, seq + step)
            windows.append(found.windows[best])
            member = found.members[best]
            one = member[0] >= 0 and member[0] == member[1]
            choice.append(int(tracks.ids[member[0]]) if one else NO_TRACK)
            if looked.known.size:
                looked = shown(
                    looked, looked.reference, windows[-1], tracks.header.geometry, seq + step
                )
        return np.stack(windows), np.array(choice, np.int32)


def finite(tracks: Tracks) -> Tracks:
    """Return the tracks whose numbers are finite."""
    arrays = (tracks.boxes, tracks.predicted, tracks.features, tracks.scores)
    sound = np.ones(len(tracks.ids), np.bool_)
    for values in arrays:
        sound &= np.isfinite(values).all(tuple(range(1, values.ndim)))
    if sound.all():
        return tracks
    return replace(tracks, **{name: getattr(tracks, name)[sound] for name in _per_track(tracks)})


def _per_track(tracks: Tracks) -> list[str]:
    names = [field.name for field in fields(tracks)]
    return [name for name in names if isinstance(getattr(tracks, name), np.ndarray)]


def network_of(settings: ActingPolicySettings) -> ActingNetwork | None:
    """Return the network that the settings name, none for a rule; raises `WeightsError`."""
    if settings.choose == "turn":
        return None
    path = Path(settings.weights) if settings.weights else SHIPPED
    return ActingNetwork(path, **settings.compute)
