"""Options of an evaluation: command-line arguments -> values, validated before any work."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from bench.options import MOST_CLIPS
from bench.outputs import PLOTS, make_room, work_folder
from bench.tracking.budgets import CONTEXT, PURSUIT, parsed
from bench.tracking.episode import Rules
from bench.tracking.replaced import PARTS, Replaced
from bench.tracking.targets import KINDS
from drivers.datasets.sequence import span
from pipeline.errors import SettingsError

ALL = (
    *("full", "oracle", "foveated", PURSUIT, CONTEXT, "centred", "round_robin"),
    *("spatial", "temporal", "exposure"),
)
GRAPH = Path(__file__).parents[2] / "graphs" / "learned.yaml"
WHOLE = (1, 0)  # frames: from the first to the end
LEAST = {
    **dict.fromkeys(("clips", "players", "every", "longest", "replan", "jobs"), 1),
    **dict.fromkeys(("delay", "seed"), 0),
}
UNUSED_BY_MANY: Mapping[str, Any] = {  # with their defaults
    "targets": tuple(KINDS), "players": 1, "every": 8, "longest": Rules.longest,
    "tracker": "", "sees": "both", "cue": "none", "protocol": "short", "states": False,
    "replan": (1,), "prediction": "kalman", "replace": (),
    "seed": 0, "plot": None,
}  # fmt: skip
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options in `fovea eval tracking --help`; each of several values has rows of its own."""

    data: str
    frames: tuple[int, int]  # first and last, counted from 1
    clips: int
    strategies: tuple[str, ...]
    budgets: tuple[Fraction, ...]
    targets: tuple[str, ...]
    players: int
    every: int
    longest: int
    graph: str
    changes: tuple[str, ...]
    tracker: str
    sees: str  # both, roi, coordinates, each, all
    cue: str  # reference, none, each
    protocol: str  # short, long, both
    many: bool  # score all tracks of perception instead
    missed: float  # with `many`: share of detections that are left out
    states: bool  # show rows of the free, the still and the carried ball, too
    policy: Mapping[str, str]  # file, pursuit or nothing by name
    delay: tuple[int, ...]
    replan: tuple[int, ...]
    prediction: str  # kalman, hold, both
    replace: tuple[tuple[str, ...], ...]
    jobs: int
    seed: int
    report: Path | None = None
    markdown: Path | None = None
    plot: Path | None = None
    work: Path | None = None

    def __post_init__(self) -> None:
        for name, least in LEAST.items():
            value = getattr(self, name)
            lowest = min(value) if isinstance(value, tuple) else value
            if lowest < least:
                raise SettingsError(f"{name}: must be at least {least}, got {lowest}")
        if self.clips > MOST_CLIPS:
            raise SettingsError(f"clips: must be at most {MOST_CLIPS}, got {self.clips}")
        first, last = self.frames
        if self.frames != WHOLE and not 1 <= first < last:
            raise SettingsError(f"frames: expected A-B with B after A, got {first}-{last}")
        for kind in self.targets:
            if kind not in KINDS:
                raise SettingsError(f"targets: expected {', '.join(KINDS)}, got {kind}")
        if self.cue != "none" and len(self.delay) > 1:
            given = ",".join(map(str, self.delay))
            raise SettingsError(
                f"delay: expected one with --cue {self.cue}, as all rows hear the same, got {given}"
            )
        if not 0 <= self.missed < 1:
            raise SettingsError(f"missed: expected 0 to below 1, got {self.missed}")
        self._refuse_unused()
        if self.plot and self.plot.suffix not in PLOTS:
            raise SettingsError(f"plot: expected {', '.join(PLOTS)} at the end, got {self.plot}")

    def _refuse_unused(self) -> None:
        """Raise `SettingsError` for what would not change the figures that are asked for."""
        if self.missed and not self.many:
            raise SettingsError(f"missed: expected only with --many, got {self.missed} without")
        for name, default in UNUSED_BY_MANY.items() if self.many else ():
            if getattr(self, name) != default:
                raise SettingsError(
                    f"{name}: expected no --{name} with --many, which does not depend on it"
                )

    @property
    def folder(self) -> Path:
        """The folder of finished units."""
        return work_folder(self.work, self.report, ".fovea-eval")

    def make_room(self) -> None:
        """Make the output folders; raises `SettingsError` for a file that cannot be written."""
        make_room(self.folder, report=self.report, markdown=self.markdown, plot=self.plot)


def options_of(given: Mapping[str, Any]) -> Options:
    """Return the options of a command line; repeated values count once."""
    strategies = given["strategies"]
    read = {
        "frames": span(given["frames"]) if given["frames"] else WHOLE,
        "strategies": ALL if strategies == "all" else _distinct(strategies.split(",")),
        "budgets": _distinct(parsed(given["budgets"])),
        "targets": _distinct(given["targets"].split(",")),
        "policy": policy_files(given["policy"]),
        "delay": numbers("delay", given["delay"]),
        "replan": numbers("replan", given["replan"]),
        "replace": _distinct(parts_of(text) for text in given["replace"]),
    }
    return Options(**{**given, **read})


def policy_files(given: Sequence[str]) -> dict[str, str]:
    """Return `--policy [NAME=]FILE|pursuit` by name; without any, the graph's own."""
    found: dict[str, str] = {}
    given = _distinct(given)
    for text in given:
        name, equals, path = text.rpartition("=")
        if path == "pursue":
            raise SettingsError("policy: pursue: renamed; expected pursuit")
        if path != "pursuit" and not Path(path).is_file():
            raise SettingsError(f"policy: expected an ONNX file or pursuit, got {path}")
        if not equals and len(given) > 1:
            name = Path(path).stem
        if name in found:
            raise SettingsError(
                f"policy: {found[name]} and {path} would both be called {name!r}; give each a name "
                "of its own: NAME=FILE"
            )
        found[name] = path
    return found or {"": ""}


def parts_of(text: str) -> tuple[str, ...]:
    """Return parts known from the truth, in the order of the loop; raises `SettingsError`.

    >>> parts_of("association+detections")
    ('detections', 'association')
    """
    wanted = Replaced(parts=frozenset(text.split("+"))).parts  # raises for an unknown part
    return tuple(part for part in PARTS if part in wanted)


def numbers(name: str, text: str) -> tuple[int, ...]:
    """Parse whole numbers; raises `SettingsError`."""
    try:
        return _distinct(int(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"{name}: expected whole numbers such as 0,2,13, got {text!r}"
        ) from None


def refuse_too_late(delay: int, reach: int) -> None:
    """Raise `SettingsError` for plans of `reach` frames that are over before they hold."""
    if delay >= reach:
        raise SettingsError(
            f"delay: plans reach {reach} frames, those {delay} frames late are over before they "
            "hold; set association.horizon and policy.horizon, and name a policy that was trained "
            "for them"
        )


def _distinct(values: Iterable[T]) -> tuple[T, ...]:
    """Return each value once, in order of first appearance."""
    return tuple(dict.fromkeys(values))
