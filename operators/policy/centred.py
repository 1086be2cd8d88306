"""A policy that always looks at the middle of the field: Tracks -> Scanpath.

A baseline of the paper.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from operators.policy.former import STRATEGY
from operators.policy.gaze_plan import check_horizon, field_centre, scanpath, stay
from operators.policy.inputs import PolicyInputs
from pipeline import Scanpath, Tracks


@dataclass(frozen=True, kw_only=True)
class CentredPolicySettings:
    """What a graph may set."""

    FORMER: ClassVar[Mapping[str, str]] = STRATEGY

    horizon: int = 16  # Tp, frames planned

    def __post_init__(self) -> None:
        check_horizon(self.horizon)


class CentredPolicy(PolicyInputs[CentredPolicySettings]):
    """Returns the same position for every frame."""

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        return scanpath(tracks, stay(field_centre(tracks.header.geometry), self.settings.horizon))
