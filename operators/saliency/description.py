"""What is known of a detector besides its weights: metadata and a side file -> a description.

Ultralytics writes `names`, `imgsz`, `stride` and `task` into the metadata as Python literals; the
shipped detector also has `confidence`, `domain` and `trained_on`. A side file beside the weights,
`MODEL.yaml` for `MODEL.onnx`, has what the metadata lacks, and precedes it. The side files of
third-party weights are beside this module, by their name in weights.toml.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

from operators.saliency.classes import checked_names
from operators.saliency.literals import Value, parse
from pipeline.errors import FoveaError, GraphError, SettingsError, WeightsError
from pipeline.graph.yaml_lines import YamlFile, plain
from pipeline.settings import WrongSetting, build
from pipeline.weights import entries, matches
from pipeline.wording import shown

Format = Literal["auto", "yolo", "obb", "yolox", "yolox_decoded", "end2end"]
TASKS = ("", "detect", "obb")
DIFFERENCE = "difference"  # key of the metadata
MOST_PX = 8192  # of a side of the input
LONGEST_TEXT = 200  # characters of `trained_on` and `domain`
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class SideFile:
    """The keys of a side file; what is missing comes from the metadata."""

    names: tuple[str, ...] = ()  # of all classes, in the network's own order
    input_px: tuple[int, int] = (0, 0)  # width, height where the network leaves them open
    format: Format = "auto"  # of the network's output
    confidence: float = 0.0  # for all classes; 0: 0.25
    class_confidence: Mapping[str, float] = field(default_factory=dict)  # by the network's names
    trained_on: str = ""
    domain: str = ""  # the only kind of scene it is for, as sources say what they show: soccer

    def __post_init__(self) -> None:
        if self.names:
            _setting("names", lambda: checked_names(self.names))
        if any(self.input_px):
            _setting("input_px", lambda: check_size(self.input_px))
        shares = {f"class_confidence.{k}": v for k, v in self.class_confidence.items()}
        for name, share in {"confidence": self.confidence, **shares}.items():
            if not 0 <= share <= 1:
                raise SettingsError(f"{name}: must be within 0..1, got {share}")
        if unknown := sorted(set(self.class_confidence) - set(self.names)):
            got = shown(unknown[0])
            raise SettingsError(f"class_confidence: expected classes of `names`, got {got}")
        for name in ("trained_on", "domain"):
            text = getattr(self, name)
            if not (text.isprintable() and len(text) <= LONGEST_TEXT):
                what = f"one line of up to {LONGEST_TEXT} characters"
                raise SettingsError(f"{name}: expected {what}, got {shown(text, 40)}")


@dataclass(frozen=True, kw_only=True)
class Description:
    """What a file and the side file say; empty: neither says it."""

    names: tuple[str, ...] = ()
    input_px: tuple[int, int] = (0, 0)  # that the side file asks for
    exported_px: tuple[int, int] = (0, 0)  # that the network was exported with
    format: Format = "auto"
    confidence: float = 0.0
    class_confidence: Mapping[str, float] = field(default_factory=dict)
    trained_on: str = ""
    domain: str = ""
    task: str = ""
    stride_px: int = 32
    difference: bool = False  # whether a fourth channel is what changed since the frame before
    places: Mapping[str, str] = field(default_factory=dict)  # where a field is from, for an error


def described(path: Path, metadata: Mapping[str, str]) -> Description:
    """Return the description of the weights at `path`; raises `WeightsError` naming the file."""
    known = of_metadata(path, metadata)
    side = side_file(path)
    return over(known, side) if side.is_file() else known


def of_metadata(path: Path, metadata: Mapping[str, str]) -> Description:
    """Return what a network's metadata says; raises `WeightsError` for what it cannot say."""
    task = metadata.get("task", "")
    if task not in TASKS:
        what = "expected a detector (task detect or obb)"
        raise WeightsError(f"{path}: {what}, got one whose metadata says task {shown(task)}")

    def take(key: str, read: Callable[[Value], T], default: T) -> T:
        try:
            return read(parse(metadata[key])) if metadata.get(key) else default
        except ValueError as error:
            raise WeightsError(f"{path}: metadata {key}: {error}") from error

    unnamed: tuple[str, ...] = ()
    names = take("names", _names, unnamed)
    return Description(
        names=names,
        exported_px=take("imgsz", _size, (0, 0)),
        class_confidence=take("confidence", lambda value: _shares(value, names), {}),
        trained_on=metadata.get("trained_on", ""),
        domain=metadata.get("domain", ""),
        task=task,
        stride_px=take("stride", _stride, 32),
        difference=take(DIFFERENCE, _truth, False),
        places={"names": f"{path}: metadata names"},
    )


def side_file(path: Path) -> Path:
    """Return where the side file of the weights at `path` is, or would be.

    It lies beside them; for an intact third-party network it is the one of this folder.
    """
    beside = path.with_suffix(".yaml")
    if beside.is_file():
        return beside
    for name, entry in entries().items():
        own = Path(__file__).with_name(f"{name}.yaml")
        if entry.file == path.name and own.is_file() and matches(path, entry):
            return own
    return beside


def over(known: Description, path: Path) -> Description:
    """Lay a side file over a description; raises `WeightsError` with file and line."""
    try:
        file = YamlFile(path)
        try:
            side = build(SideFile, plain(file.document), "detector")
        except WrongSetting as error:
            raise WeightsError(f"{file.deepest(file.document, error.path)}: {error}") from error
        except SettingsError as error:
            raise WeightsError(f"{path}:1: {error}") from error
    except GraphError as error:
        raise WeightsError(str(error)) from error
    written = {f.name: getattr(side, f.name) for f in fields(side) if f.name in file.document}
    places = {name: f"{file.at(file.document, name)}: detector.{name}" for name in written}
    if side.names or side.confidence:  # what the metadata says is for other names, or for others
        written.setdefault("class_confidence", {})
    return replace(known, places={**known.places, **places}, **written)


def check_size(size_px: tuple[int, int]) -> None:
    """Raise `ValueError` unless these are a width and a height that an input may have."""
    if not all(1 <= side <= MOST_PX for side in size_px):
        raise ValueError(f"expected a width and a height of 1 to {MOST_PX}, got {size_px}")


def _setting(name: str, check: Callable[[], object]) -> None:
    try:
        check()
    except ValueError as error:
        if isinstance(error, FoveaError):
            raise
        raise SettingsError(f"{name}: {error}") from error


def _names(value: Value) -> tuple[str, ...]:
    """Names in order, from a list, or from a table by numbers 0 to n - 1."""
    if isinstance(value, dict):
        try:
            table = {int(key): name for key, name in value.items()}
        except ValueError as error:
            raise ValueError(f"expected numbers as keys, got {shown(list(value))}") from error
        if sorted(table) != list(range(len(value))):
            raise ValueError(f"expected the keys 0 to {len(value) - 1}, got {shown(list(value))}")
        return checked_names(table[number] for number in range(len(table)))
    if not isinstance(value, list):
        raise ValueError(f"expected a table or a list of names, got {shown(value)}")
    return checked_names(value)


def _size(value: Value) -> tuple[int, int]:
    """Width and height, from Ultralytics' height and width or one number for both."""
    sides: Any = [value, value] if isinstance(value, int) else value
    if not isinstance(sides, list) or len(sides) != 2 or any(type(s) is not int for s in sides):
        raise ValueError(f"expected height and width, got {shown(value)}")
    check_size((sides[1], sides[0]))
    return sides[1], sides[0]


def _truth(value: Value) -> bool:
    if type(value) is not bool:
        raise ValueError(f"expected True or False, got {shown(value)}")
    return value


def _stride(value: Value) -> int:
    if type(value) is not int or not 1 <= value <= 512:
        raise ValueError(f"expected a whole number of 1 to 512, got {shown(value)}")
    return value


def _shares(value: Value, names: tuple[str, ...]) -> dict[str, float]:
    if not isinstance(value, dict):
        raise ValueError(f"expected a table of classes, got {shown(value)}")
    for name, share in value.items():
        if name not in names:
            raise ValueError(f"expected classes among the names, got {shown(name)}")
        if type(share) not in (int, float) or not 0 <= float(str(share)) <= 1:
            raise ValueError(f"{name}: expected 0..1, got {shown(share)}")
    return {str(name): float(str(share)) for name, share in value.items()}
