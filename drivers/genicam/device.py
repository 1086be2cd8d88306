"""One industrial camera: its features by name, its description, its streams."""

import contextlib
import threading
from typing import Any

from drivers.genicam.aravis import library, told
from drivers.genicam.nodes import NodeMap
from drivers.genicam.stream import CHUNKS, Stream
from drivers.genicam.vetting import vetted_nodes
from pipeline.errors import DriverError
from pipeline.settings import suggest
from pipeline.text import harmless

INTEGERS = ("Integer", "IntReg", "MaskedIntReg", "IntConverter", "IntSwissKnife", "StructEntry")
FLOATS = ("Float", "FloatReg", "Converter", "SwissKnife")
TEXTS = ("String", "StringReg")
_FEATURES = ("Integer", "Float", "Enumeration", "Boolean", "Command", "String")

FeatureValue = bool | int | float | str


class Device:
    """One open camera. Features are named by SFNC or as the camera's description names them."""

    def __init__(self, key: str, *, listed: bool = False) -> None:
        """Open by id, user name, serial or address; raises `DriverError`.

        `listed`: the key is an id that the search returned.
        """
        found = library()
        self.key, self.id = key, key if listed else ""
        with told(f"camera {harmless(key, 60)}"):
            self._device = found.aravis.open_device(key)
        if self._device is None:
            raise DriverError(f"camera {harmless(key, 60)}: expected a device, got no answer")
        self.lost = threading.Event()
        self._handler = self._device.connect("control-lost", lambda _device: self.lost.set())
        try:
            self.nodes: NodeMap = self._described()
            self._camera = found.aravis.Camera.new_with_device(self._device)
            self._check_control()
        except BaseException:
            self.close()
            raise

    @property
    def protocol(self) -> str:
        """GigE or USB3."""
        return "GigE" if self.network else "USB3"

    @property
    def link(self) -> str:
        """The link as `pipeline.planner.links` names it; empty: the camera does not tell."""
        speed, mbits = self.known("DeviceLinkSpeed"), self.known("GevLinkSpeed")
        return link_kind(self.protocol, float(speed or (mbits or 0) * 125_000))

    @property
    def network(self) -> bool:
        """Whether it is a GigE Vision camera."""
        return isinstance(self._device, library().aravis.GvDevice)

    def kind(self, name: str) -> str:
        """The element that describes a feature; raises `DriverError` when there is none."""
        node = self.nodes.get(name)
        if node is None:
            features = [n.name for n in self.nodes.nodes.values() if n.kind in _FEATURES]
            hint = suggest(name, features) if len(features) < 20 else _near(name, features)
            raise DriverError(f"{self.key}: no feature {harmless(name, 60)}{hint}")
        return node.kind

    def has(self, name: str) -> bool:
        """Whether the camera has a feature and does not declare it missing."""
        if self.nodes.get(name) is None:
            return False
        try:
            return bool(self._device.is_feature_available(name))
        except library().error:
            return False

    def integer(self, name: str) -> int:
        """Value of a whole number or of a register."""
        with told(f"{self.key}: {name}"):
            return int(self._device.get_integer_feature_value(name))

    def known(self, name: str) -> int | float | None:
        """Value of a node; None when the camera does not tell."""
        node = self.nodes.get(name)
        try:
            if node is not None and node.kind in FLOATS:
                return float(self._device.get_float_feature_value(name))
            return int(self._device.get_integer_feature_value(name))
        except library().error:
            return None

    def text(self, name: str) -> str:
        """Value of a text or an enumeration; empty when the camera does not tell."""
        try:
            return harmless(self._device.get_string_feature_value(name) or "", 120)
        except library().error:
            return ""

    def write(self, name: str, value: FeatureValue) -> None:
        """Set a feature, or execute a command; raises `DriverError` with what is possible."""
        kind, device = self.kind(name), self._device
        where = f"{self.key}: {name}"
        with told(f"{where}: {harmless(repr(value), 60)} is refused"):
            if kind == "Command":
                device.execute_command(name)
            elif kind == "Boolean" and isinstance(value, bool):
                device.set_boolean_feature_value(name, value)
            elif kind == "Enumeration" and isinstance(value, str):
                self._check_entry(where, name, value)
                device.set_string_feature_value(name, value)
            elif kind in TEXTS and isinstance(value, str):
                device.set_string_feature_value(name, value)
            elif kind in INTEGERS and type(value) is int:
                self._check_range(where, device.get_integer_feature_bounds(name), value)
                device.set_integer_feature_value(name, value)
            elif kind in FLOATS and type(value) in (int, float):
                self._check_range(where, device.get_float_feature_bounds(name), float(value))
                device.set_float_feature_value(name, float(value))
            else:
                raise DriverError(f"{where}: expected {_wanted(kind)}, got {value!r}")

    def put(self, name: str, value: int | str) -> None:
        """Set a feature whose range is known, in one transaction."""
        with told(f"{self.key}: {name}: {value} is refused"):
            if isinstance(value, int):
                self._device.set_integer_feature_value(name, value)
            else:
                self._device.set_string_feature_value(name, value)

    def execute(self, name: str) -> None:
        """Execute a command."""
        with told(f"{self.key}: {name}"):
            self._device.execute_command(name)

    def step(self, name: str) -> int:
        """Step of a whole number, at least 1."""
        try:
            return max(int(self._device.get_integer_feature_increment(name)), 1)
        except library().error:
            return 1

    def set_rate(self, rate_hz: float) -> None:
        """Set the frame rate, by whichever features this camera has for it."""
        with told(f"{self.key}: rate_hz: {rate_hz:g} is refused"):
            low, high = self._camera.get_frame_rate_bounds()
            if low <= high and not low <= rate_hz <= high:
                raise DriverError(
                    f"{self.key}: rate_hz: expected {low:g} to {high:g}, got {rate_hz:g}"
                )
            self._camera.set_frame_rate(rate_hz)

    def rates(self) -> tuple[float, float]:
        """Lowest and highest frame rate; 0: the camera does not tell."""
        try:
            low, high = self._camera.get_frame_rate_bounds()
        except library().error:
            return 0.0, 0.0
        return float(low), float(high)

    def rate(self) -> float:
        """Frame rate; 0: the camera does not tell."""
        try:
            return float(self._camera.get_frame_rate())
        except library().error:
            return 0.0

    def enable_chunks(self) -> Any:
        """Have stamps and offsets sent with each frame; None where the camera has no chunks."""
        try:
            if not self._camera.are_chunks_available():
                return None
            self._camera.set_chunk_mode(True)
            for name in CHUNKS:
                with contextlib.suppress(library().error):
                    self._camera.set_chunk_state(name, True)
            return self._camera.create_chunk_parser()
        except library().error:
            return None

    def stream(self, buffers: int, parser: Any = None, packet_bytes: int = 0) -> "Stream":
        """Allocate `buffers` buffers for the present payload; raises `DriverError`."""
        with told(f"{self.key}: stream"):
            if self.network:
                self._set_packet_size(packet_bytes)
            payload = int(self._camera.get_payload())
            if not 0 < payload <= 1 << 30:
                raise DriverError(f"{self.key}: expected a payload up to 1 GiB, got {payload}")
            stream = self._camera.create_stream(None, None)
        if stream is None:
            raise DriverError(f"{self.key}: expected a stream, got none")
        return Stream(stream, payload, buffers, parser)

    def acquire(self, on: bool) -> None:
        """Begin or end to expose; what must not change meanwhile is locked."""
        if on:
            self._lock(1)
        self.execute("AcquisitionStart" if on else "AcquisitionStop")
        if not on:
            self._lock(0)

    def answers(self) -> bool:
        """Whether the camera still answers and is controlled by this process."""
        try:
            self._device.get_integer_feature_value("Width")
            return not self.network or bool(self._device.is_controller())
        except library().error:
            return False

    def close(self) -> None:
        """Release the device; what the camera does not answer any more is left out."""
        device, self._device, self._camera = self._device, None, None
        if device is None:
            return
        device.disconnect(self._handler)
        if not self.lost.is_set() and isinstance(device, library().aravis.GvDevice):
            with contextlib.suppress(library().error):
                device.leave_control()

    def _described(self) -> NodeMap:
        text = library().native.description(self._device)
        if not text:
            raise DriverError(f"{self.key}: expected a description (GenICam XML), got none")
        return vetted_nodes(text)

    def _check_control(self) -> None:
        if self.network and not self._device.is_controller():
            raise DriverError(f"{self.key}: expected a free camera, got one in use by another host")

    def _set_packet_size(self, packet_bytes: int) -> None:
        if packet_bytes:
            self._camera.gv_set_packet_size(packet_bytes)
        else:
            with contextlib.suppress(library().error):  # a camera that cannot test packets
                self._camera.gv_auto_packet_size()

    def _lock(self, state: int) -> None:
        if self.nodes.get("TLParamsLocked") is not None:
            with contextlib.suppress(library().error):
                self._device.set_integer_feature_value("TLParamsLocked", state)

    def _check_entry(self, where: str, name: str, value: str) -> None:
        entries = self._device.dup_available_enumeration_feature_values_as_strings(name) or ()
        if value not in entries:
            known = ", ".join(harmless(entry, 40) for entry in entries[:20])
            raise DriverError(f"{where}: expected one of {known}, got {harmless(value, 40)}")

    def _check_range(self, where: str, bounds: Any, value: float) -> None:
        low, high = bounds[0], bounds[1]
        if low <= high and not low <= value <= high:
            raise DriverError(f"{where}: expected {low:g} to {high:g}, got {value:g}")


def link_kind(protocol: str, speed: float) -> str:
    """Return the kind of link by its raw speed in bytes a second (SFNC: DeviceLinkSpeed).

    >>> link_kind("GigE", 125e6), link_kind("GigE", 1250e6), link_kind("USB3", 625e6)
    ('gige', '', 'usb3.0')
    """
    kinds = {"GigE": ((125e6, "gige"),), "USB3": ((625e6, "usb3.0"), (1250e6, "usb3.1"))}
    return next((kind for most, kind in kinds.get(protocol, ()) if 0 < speed <= most), "")


def _near(name: str, features: list[str]) -> str:
    hint = suggest(name, features)
    return hint if hint.startswith(", did you mean") else ""


def _wanted(kind: str) -> str:
    if kind in INTEGERS:
        return "a whole number"
    if kind in FLOATS:
        return "a number"
    return {"Boolean": "true or false"}.get(kind, "a text")
