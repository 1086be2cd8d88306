"""What policies share that show any object, or all of one class in turn."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from operators.policy.former import STRATEGY
from operators.policy.gaze_plan import check_horizon
from operators.policy.inputs import PolicyInputs
from operators.policy.target import check_known, check_label


@dataclass(frozen=True, kw_only=True)
class ClassPolicySettings:
    """What a graph may set of each of them."""

    FORMER: ClassVar[Mapping[str, str]] = STRATEGY

    target: str = ""  # class name (ball, referee, player …) to show only; empty: any
    horizon: int = 16  # Tp, frames planned

    def __post_init__(self) -> None:
        check_horizon(self.horizon)


S = TypeVar("S", bound=ClassPolicySettings)


class ClassPolicy(PolicyInputs[S]):
    """The inputs that make policies interchangeable, and a target that may change while it runs.

    A class that overrides `open` or `on_tracks` calls the one here.
    """

    live: ClassVar[tuple[str, ...]] = ("target",)

    @classmethod
    def advise(cls, settings: S, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `SettingsError` for a class that the detector does not know."""
        check_known(settings.target, upstream)
        return ()

    def open(self) -> None:
        """Start without knowing the classes that tracks have."""
        self._names: Sequence[str] = ()

    def on_settings(self, settings: S) -> None:
        """Another class from the next plan on; raises `SettingsError` where tracks have none."""
        if settings.target != self.settings.target:
            check_label(settings.target, self._names)
        self.settings = settings
