"""What `fovea sensors test NAME` tests: a name in, a sensor class with its settings out.

Settings are those of the shipped source files, so that a graph run with `--source` meets the same
sensor.
"""

import contextlib
import os
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.sensor import DualStreamSensor
from pipeline.errors import DriverError, GraphError, SettingsError
from pipeline.graph.overlay import read_value, shown_change, source_document
from pipeline.graph.shipped import source_names, source_path
from pipeline.graph.yaml_lines import plain
from pipeline.import_path import imported, is_import_path
from pipeline.settings import build
from pipeline.text import harmless
from pipeline.wording import shown

FORMS = "usb:SERIAL, genicam:ID, /dev/videoN, a URL, virtual, fake, module:Class or a source file"
MOST_BYTES = 1000  # of what the fake camera says when it ends
FAKE_S = 30.0  # in which the fake camera has to be ready
FAKE = "Aravis-Fake-F1"  # what Aravis' own camera is called


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A sensor, not yet open."""

    name: str
    sensor: str  # import path
    options: Mapping[str, Any]

    def make(self) -> DualStreamSensor:
        """Return a new sensor; raises `SettingsError`."""
        found = imported(self.sensor, SettingsError, "sensor")
        if not hasattr(found, "settings_type"):
            raise SettingsError(f"sensor: expected a DualStreamSensor, got {self.sensor}")
        built: DualStreamSensor = found(build(found.settings_type, self.options, "options"))
        return built


@contextlib.contextmanager
def subject_of(name: str, changes: Sequence[str] = ()) -> Iterator[Subject]:
    """Yield the sensor of that name, with changes `OPTION=VALUE` of its settings.

    Raises `SettingsError` for a name that is none. Aravis' fake camera runs meanwhile.
    """
    with contextlib.ExitStack() as meanwhile:
        if name == "fake":
            meanwhile.enter_context(_fake_camera())
        sensor, options = _named(f"genicam:{FAKE}" if name == "fake" else name)
        for change in changes:
            _lay(options, change)
        yield Subject(name=name, sensor=sensor, options=options)


def _named(name: str) -> tuple[str, dict[str, Any]]:
    kind, _, rest = name.partition(":")
    if kind == "usb" and rest:
        return _board(rest)
    if kind == "genicam" and rest:
        return _industrial(rest)
    if "://" in name:
        return _source("rtsp", "camera_options.url", name)
    if name.startswith("/dev/"):
        return _source("webcam", "camera_options.device", name)
    if is_import_path(name):
        return _class(name)
    if name == "virtual":
        return _source("virtual_board")
    if name in source_names() or Path(name).suffix in (".yaml", ".yml"):
        return _source(name)
    raise SettingsError(
        f"{shown(name)}: expected {FORMS}, got no such name; `fovea sensors` lists what is attached"
    )


def _source(name: str, key: str = "", value: str = "") -> tuple[str, dict[str, Any]]:
    """Return sensor and options of a source file, with one option changed."""
    document = source_document(source_path(name)).document
    settings = plain(document.get("settings", {}))
    options: dict[str, Any] = settings.get("options", {})
    if key:
        _put(options, key, value)
    return settings.get("sensor", "drivers.simulated:SimulatedSensor"), options


def _class(path: str) -> tuple[str, dict[str, Any]]:
    """Return a sensor by its class, or what makes one of a plain camera."""
    found = imported(path, SettingsError, "sensor")
    if not hasattr(found, "set_rois") and callable(getattr(found, "read", None)):
        return "drivers.cameras:CameraSensor", {"camera": path}
    return path, {}


def _board(serial: str) -> tuple[str, dict[str, Any]]:
    """Return a board, in the mode `record` where it has no other."""
    from drivers.attached.boards import only_records  # pyusb is an extra

    sensor, options = _source("usb", "serial", serial)
    if only_records(serial):
        options["mode"] = "record"
    return sensor, options


def _industrial(camera: str) -> tuple[str, dict[str, Any]]:
    """Return a camera as a foveating sensor, or as a plain one where it cannot be that."""
    from drivers.genicam.discovery import discover  # Aravis is an extra

    found = [one for one in discover() if camera in (one.id, one.serial, one.address)]
    if found and found[0].problem:
        raise DriverError(found[0].problem)
    if found and not found[0].foveation.means:
        return _source("genicam", "camera_options.camera", camera)
    return _source("genicam_foveated", "camera", camera)


def _lay(options: dict[str, Any], change: str) -> None:
    name, equals, text = change.partition("=")
    if not (equals and name):
        raise GraphError(f"--set {shown_change(change)}: expected OPTION=VALUE")
    _put(options, name, plain(read_value(text, name)), f"--set {shown_change(change)}: ")


def _put(options: dict[str, Any], name: str, value: Any, place: str = "") -> None:
    *path, last = name.split(".")
    for key in path:
        options = options.setdefault(key, {})
        if not isinstance(options, dict):
            raise GraphError(f"{place}{key}: expected a mapping to change, got {shown(options)}")
    options[last] = value


@contextlib.contextmanager
def _fake_camera() -> Iterator[None]:
    command = [sys.executable, "-m", "drivers.genicam.fake_camera"]
    nothing, pipe = subprocess.DEVNULL, subprocess.PIPE
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(command, stdin=nothing, stdout=pipe, stderr=words)
        try:
            if not _ready(process):
                said = os.pread(words.fileno(), MOST_BYTES, 0).decode(errors="replace").strip()
                raise DriverError(f"fake: {harmless(said) or 'the fake camera ended'}")
            yield
        finally:
            process.kill()
            process.communicate()


def _ready(process: subprocess.Popen[bytes]) -> bool:
    """Return whether the program has said so; raises `DriverError` when it says nothing."""
    assert process.stdout is not None
    with selectors.DefaultSelector() as waiting:
        waiting.register(process.stdout, selectors.EVENT_READ)
        if not waiting.select(FAKE_S):
            raise DriverError(f"fake: expected the fake camera within {FAKE_S:g} s, got nothing")
    # the program writes the line at once
    return os.read(process.stdout.fileno(), MOST_BYTES).strip() == b"ready"
