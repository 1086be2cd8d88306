"""Scenes and recordings by name: settings values in, an open FrameSource out."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from drivers.simulated.checked import check_source
from drivers.source import FrameSource
from pipeline.errors import SettingsError
from pipeline.import_path import imported
from pipeline.settings import fit

SCENES = {
    "soccer": "drivers.scenes:SoccerScene",
    "panorama": "drivers.scenes:PanoramaScene",
    "road": "drivers.scenes:RoadScene",
    "insertion": "drivers.scenes:InsertionScene",
}
CAMERAS = {  # of the scene `soccer`, by its option `camera`: each draws in a way of its own
    "broadcast": "drivers.scenes:SoccerScene",
    "whole": "drivers.scenes:WholePitchScene",
}
FORMER = {  # import paths of earlier versions
    "drivers.images:ImageFolder": "drivers.datasets:ImageFolder",
    "drivers.mot:MotSequence": "drivers.datasets:MotSequence",
    "drivers.soccer:SoccerScene": "drivers.scenes:SoccerScene",
    "drivers.soccernet:SoccerNetSequence": "drivers.datasets:SoccerNetSequence",
    "drivers.video:VideoFile": "drivers.datasets:VideoFile",
}


def open_scene(
    scene: str,
    *,
    size_px: tuple[int, int],
    rate_hz: float,
    seed: int,
    length: int | None,
    options: Mapping[str, Any],
) -> FrameSource:
    """A procedural scene; (0, 0) and 0 leave its own size and rate."""
    values: dict[str, Any] = {"seed": seed, "length": length, **options}
    path = scene_path(scene)
    if scene == "soccer":
        path = _camera_path(values.pop("camera", "broadcast"))
    if size_px != (0, 0):
        values["size_px"] = size_px
    if rate_hz:
        values["rate_hz"] = rate_hz
    return _build("scene", path, values)


def open_recording(source: str, *, path: str, options: Mapping[str, Any]) -> FrameSource:
    """A recording; raises `DriverError` where the files are not what they should be."""
    return _build("source", source, {"path": path, **options} if path else dict(options))


def scene_path(scene: str) -> str:
    """The import path behind a scene's name; an import path stands for itself."""
    if ":" in scene:
        return scene
    if scene not in SCENES:
        raise SettingsError(
            f"scene: expected {', '.join(SCENES)} or an import path module:Class, got {scene!r}"
        )
    return SCENES[scene]


def _camera_path(camera: object) -> str:
    """The import path of the soccer scene before this camera."""
    if not isinstance(camera, str) or camera not in CAMERAS:
        raise SettingsError(f"camera: expected {' or '.join(CAMERAS)}, got {camera!r}")
    return CAMERAS[camera]


def load_source(setting: str, path: str) -> Callable[..., FrameSource]:
    """The class behind `module:Class`; raises `SettingsError` naming the setting."""
    if path in FORMER:
        raise SettingsError(f"{setting}: {path}: renamed; expected {FORMER[path]}")
    found = imported(path, SettingsError, setting)
    if not callable(getattr(found, "picture", None)):
        raise SettingsError(f"{setting}: expected a FrameSource, got {path}")
    return found  # type: ignore[no-any-return]


def shown_by(path: str) -> str:
    """The kind of scene that a source's class says it shows, empty for none."""
    return str(getattr(load_source("source", path), "shows", ""))


def check_arguments(setting: str, path: str, names: Mapping[str, Any]) -> None:
    """Raise `SettingsError` unless the source takes these names and lacks no other."""
    parameters = inspect.signature(load_source(setting, path)).parameters
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for name in names:
        if name not in parameters and not open_ended:
            known = ", ".join(parameters)
            raise SettingsError(f"{setting}: {path} takes {known}, got {name}")
    for name, parameter in parameters.items():
        plain = parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        if plain and parameter.default is parameter.empty and name not in names:
            place = name if name == "path" else f"source_options.{name}"
            raise SettingsError(f"{place}: required by {path}, got nothing")


def _build(setting: str, path: str, values: dict[str, Any]) -> FrameSource:
    check_arguments(setting, path, values)
    source = load_source(setting, path)
    kinds = _kinds(source)
    fitting = {n: fit(kinds[n], v, n) if n in kinds else v for n, v in values.items()}
    made = source(**fitting)
    check_source(made)
    return made


def _kinds(source: Callable[..., FrameSource]) -> dict[str, Any]:
    """Return the types that a source declares for what it takes; empty where they cannot be had."""
    maker = source.__init__ if inspect.isclass(source) else source
    try:
        return get_type_hints(maker)
    except Exception:  # a name that only type checkers know
        return {}
