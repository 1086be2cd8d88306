"""A GigE Vision camera on the loopback, in Python: for what Aravis' own fake camera does not do.

It keeps locks while it streams, has a sequencer and a command latency, and can lose packets, stop
to answer and die. GigE Vision 1.2: GVCP (control) and GVSP (frames).
"""

import contextlib
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.drivers.genicam import description

PORT = 3956
XML_AT = 0x100000
CONTROL, HEARTBEAT, STREAM_PORT, PACKET = 0xA00, 0x938, 0xD00, 0xD04
CODES = {"Mono8": 0x01080001, "Mono12p": 0x010C0047, "Mono12Packed": 0x010C0006}
DENIED = 0x8006
FEATURES = {
    "Width": 0x10000, "Height": 0x10004, "OffsetX": 0x10008, "OffsetY": 0x1000C,
    "BinningHorizontal": 0x10010, "BinningVertical": 0x10014, "PixelFormat": 0x10018,
    "TriggerMode": 0x1001C, "TriggerSource": 0x10020, "TriggerSoftware": 0x10024,
    "AcquisitionStart": 0x10028, "AcquisitionStop": 0x1002C, "PayloadSize": 0x10030,
    "SequencerMode": 0x10034, "SequencerConfigurationMode": 0x10038,
    "SequencerFeatureSelector": 0x1003C, "SequencerFeatureEnable": 0x10040,
    "SequencerSetSelector": 0x10044, "SequencerSetSave": 0x10048, "SequencerSetLoad": 0x1004C,
}  # fmt: skip
NAMES = {address: name for name, address in FEATURES.items()}
STORED = ("OffsetX", "OffsetY", "BinningHorizontal", "BinningVertical")
SWITCH = (("Off", 0), ("On", 1))


@dataclass(kw_only=True)
class Nature:
    """What the camera is like."""

    sensor_px: tuple[int, int] = (256, 128)
    locked: tuple[str, ...] = ()  # while it streams
    sets: int = 0  # of the sequencer; 0: it has none
    latency_frames: int = 0
    states_offsets: bool = True  # in its leaders
    follows: bool = True  # False: offsets are accepted and ignored
    period_s: float = 0.01  # of free running
    xml: bytes = b""  # in place of the true description
    pixel_format: str = "Mono8"  # or Mono12p, Mono12Packed
    wide_when_binned: bool = False  # binning changes the size of the frame
    lost: list[int] = field(default_factory=list)  # numbers of frames that lack a packet


def describe(nature: Nature) -> bytes:
    """The camera's description, true to its nature."""
    at, (width, height) = FEATURES, nature.sensor_px

    def lock(name: str) -> str:
        return "TLParamsLocked" if name in nature.locked else ""

    nodes = [
        '<Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>',
        description.constant("SensorWidth", width),
        description.constant("SensorHeight", height),
        description.integer("Width", at["Width"], 4, width, step=4, lock=lock("Width")),
        description.integer("Height", at["Height"], 2, height, step=2, lock=lock("Height")),
        description.integer("OffsetX", at["OffsetX"], 0, width, step=4, lock=lock("OffsetX")),
        description.integer("OffsetY", at["OffsetY"], 0, height, step=2, lock=lock("OffsetY")),
        description.choice(
            "PixelFormat", at["PixelFormat"], [(nature.pixel_format, CODES[nature.pixel_format])]
        ),
        description.choice("TriggerMode", at["TriggerMode"], SWITCH),
        description.choice("TriggerSource", at["TriggerSource"], [("Line0", 0), ("Software", 1)]),
        description.command("TriggerSoftware", at["TriggerSoftware"]),
        description.command("AcquisitionStart", at["AcquisitionStart"]),
        description.command("AcquisitionStop", at["AcquisitionStop"]),
        description.integer("PayloadSize", at["PayloadSize"], 0, 1 << 24),
        *(
            description.integer(name, at[name], 1, 8, lock=lock(name))
            for name in ("BinningHorizontal", "BinningVertical")
        ),
    ]
    if nature.sets:
        features = [(name, i) for i, name in enumerate(STORED)]
        nodes += [
            description.choice("SequencerMode", at["SequencerMode"], SWITCH),
            description.choice(
                "SequencerConfigurationMode", at["SequencerConfigurationMode"], SWITCH
            ),
            description.choice(
                "SequencerFeatureSelector", at["SequencerFeatureSelector"], features
            ),
            description.integer(
                "SequencerSetSelector", at["SequencerSetSelector"], 0, nature.sets - 1
            ),
            description.command("SequencerSetSave", at["SequencerSetSave"]),
            description.command("SequencerSetLoad", at["SequencerSetLoad"]),
        ]
    return description.whole(nodes)


def scene(sensor_px: tuple[int, int]) -> NDArray[np.uint8]:
    """What the camera looks at: (h, w), every place has its own surroundings."""
    x, y = np.meshgrid(np.arange(sensor_px[0]), np.arange(sensor_px[1]))
    return ((x * 7 + y * 13 + (x * y) // 5) % 251).astype(np.uint8)


def twelve_bits(picture: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """What a camera of 12 bit sends of it: the upper 8 bits of a sample are its value."""
    return picture.astype(np.uint16) << 4 | picture % 13


def wire(picture: NDArray[np.uint8], pixel_format: str) -> bytes:
    """The bytes of a picture in one of the `CODES`."""
    if pixel_format == "Mono8":
        return picture.tobytes()
    first, second = (twelve_bits(picture)[:, place::2] for place in (0, 1))
    if pixel_format == "Mono12p":
        middle = first >> 8 | (second & 0xF) << 4
        parts = (first & 0xFF, middle, second >> 4)
    else:
        parts = (first >> 4, first & 0xF | (second & 0xF) << 4, second >> 4)
    return np.stack(parts, axis=-1).astype(np.uint8).tobytes()


class VirtualCamera:
    """Answers on 127.0.0.1 from construction to `close`."""

    def __init__(self, nature: Nature | None = None, *, serial: str = "V1") -> None:
        self.nature = nature or Nature()
        self.xml = self.nature.xml or describe(self.nature)
        self._scene = scene(self.nature.sensor_px)
        self._boot = bytearray(0x1000)
        self._values = dict.fromkeys(FEATURES, 0)
        self._values |= {"BinningHorizontal": 1, "BinningVertical": 1}
        self._code = CODES[self.nature.pixel_format]
        self._values["PixelFormat"] = self._code
        self._values["Width"], self._values["Height"] = self.nature.sensor_px
        self._sets: dict[int, dict[str, int]] = {}
        self._states: deque[dict[str, int]] = deque()
        self.streaming = self.mute = False
        self.frames = self.denied = 0
        self._peer: tuple[str, int] | None = None  # who controls it
        self._ended = threading.Event()
        self._fill_boot(serial)
        hosts = ("127.0.0.1", "127.255.255.255", "255.255.255.255")
        self._sockets = [_bound(host) for host in hosts]
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._thread = threading.Thread(target=self._work, name="virtual camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Die: nothing is answered any more."""
        self._ended.set()
        self._thread.join()
        for one in (*self._sockets, self._out):
            one.close()

    def __enter__(self) -> "VirtualCamera":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _work(self) -> None:
        due_s = time.monotonic()
        while not self._ended.is_set():
            for ready in select.select(self._sockets, [], [], 0.002)[0]:
                packet, peer = ready.recvfrom(2048)
                answer = b"" if self.mute else self._answer(packet, peer)
                if answer:
                    ready.sendto(answer, peer)
            free = self.streaming and not self._values["TriggerMode"]
            if free and time.monotonic() >= due_s:
                due_s = time.monotonic() + self.nature.period_s
                self._expose()

    def _answer(self, packet: bytes, peer: tuple[str, int]) -> bytes:
        _, _, order, size, number = struct.unpack(">BBHHH", packet[:8])
        status, body = 0, packet[8 : 8 + size]
        if order == 0x0002:
            found = bytes(self._boot[:0xF8])
        elif order == 0x0080:
            found = b"".join(self._read(a, 4) for (a,) in struct.iter_unpack(">I", body))
        elif order == 0x0082:
            status = max(self._write(*pair, peer) for pair in struct.iter_unpack(">II", body))
            found = struct.pack(">HH", 0, len(body) // 8)
        elif order == 0x0084:
            address, _, count = struct.unpack(">IHH", body[:8])
            found = body[:4] + self._read(address, count)
        elif order == 0x0086:
            address, value = struct.unpack(">II", body[:8])
            status = self._write(address, value, peer)
            found = struct.pack(">HH", 0, 4)
        else:
            return b""
        return struct.pack(">HHHH", status, order + 1, len(found), number) + found

    def _read(self, address: int, count: int) -> bytes:
        if address >= XML_AT:
            return self.xml[address - XML_AT :][:count].ljust(count, b"\0")
        if address in NAMES:
            return struct.pack(">I", self._value(NAMES[address]))[:count].ljust(count, b"\0")
        return bytes(self._boot[address : address + count]).ljust(count, b"\0")

    def _value(self, name: str) -> int:
        if name == "PayloadSize":
            pixels = self._values["Width"] * self._values["Height"]
            return pixels if self.nature.pixel_format == "Mono8" else pixels * 3 // 2
        return self._values[name]

    def _write(self, address: int, value: int, peer: tuple[str, int]) -> int:
        if self._peer not in (None, peer):
            return DENIED
        name = NAMES.get(address)
        if name is None:
            if address + 4 <= len(self._boot):
                self._boot[address : address + 4] = struct.pack(">I", value)
            if address == CONTROL:
                self._peer = peer if value else None
                self.streaming = self.streaming and bool(value)
            return 0
        if self.streaming and name in self.nature.locked:
            self.denied += 1
            return DENIED
        self._values[name] = value
        if name in ("AcquisitionStart", "AcquisitionStop"):
            self.streaming = name == "AcquisitionStart"
            self._states.clear()
        elif name == "TriggerSoftware" and self.streaming:
            self._expose()
        elif name == "SequencerSetSave":
            chosen = self._values["SequencerSetSelector"]
            self._sets[chosen] = {key: self._values[key] for key in STORED}
        elif name == "SequencerSetLoad":
            self._values |= self._sets.get(self._values["SequencerSetSelector"], {})
        return 0

    def _expose(self) -> None:
        self._states.append(dict(self._values))
        state = self._states[0]
        if len(self._states) > self.nature.latency_frames:
            self._states.popleft()
        picture = self._picture(state)
        self.frames += 1
        picture[0, 0] = self.frames % 251
        self._send(picture, state, broken=self.frames in self.nature.lost)

    def _picture(self, state: dict[str, int]) -> NDArray[np.uint8]:
        factor, width, height = state["BinningHorizontal"], state["Width"], state["Height"]
        if self.nature.wide_when_binned and factor > 1:
            width //= 2
        x, y = (state["OffsetX"], state["OffsetY"]) if self.nature.follows else (0, 0)
        seen = self._scene[::factor, ::factor][y : y + height, x : x + width]
        picture = np.zeros((height, width), np.uint8)
        picture[: seen.shape[0], : seen.shape[1]] = seen
        return picture

    def _send(self, picture: NDArray[np.uint8], state: dict[str, int], *, broken: bool) -> None:
        (port,) = struct.unpack(">I", self._boot[STREAM_PORT : STREAM_PORT + 4])
        stamp, number = time.monotonic_ns() + (1 << 50), (self.frames - 1) % 0xFFFF + 1
        offset = (state["OffsetX"], state["OffsetY"])
        if not (self.nature.states_offsets and self.nature.follows):
            offset = (0, 0)
        height, width = picture.shape
        leader = struct.pack(">HHIIIIIII", 0, 1, stamp >> 32, stamp & 0xFFFFFFFF, self._code,
                             width, height, *offset) + bytes(4)  # fmt: skip
        step = (struct.unpack(">I", self._boot[PACKET : PACKET + 4])[0] & 0xFFFF) - 36
        data = wire(picture, self.nature.pixel_format)
        parts = [data[i : i + step] for i in range(0, len(data), step)]
        packets = [(1, leader), *((3, part) for part in parts)]
        packets.append((2, struct.pack(">HHI", 0, 1, height)))
        for place, (kind, payload) in enumerate(packets):
            if broken and place == 1:
                continue
            head = struct.pack(">HHI", 0, number, kind << 24 | place)
            with contextlib.suppress(OSError):
                self._out.sendto(head + payload, ("127.0.0.1", port))

    def _fill_boot(self, serial: str) -> None:
        boot = self._boot
        struct.pack_into(">II", boot, 0, 0x00010002, 0x80000001)
        boot[0x24:0x28] = socket.inet_aton("127.0.0.1")
        for place, text in ((0x48, "Fovea"), (0x68, "Virtual"), (0x88, "1"), (0xD8, serial)):
            boot[place : place + len(text)] = text.encode()
        url = f"Local:virtual.xml;{XML_AT:x};{len(self.xml):x}".encode()
        boot[0x200 : 0x200 + len(url)] = url
        struct.pack_into(">I", boot, 0x904, 1)
        struct.pack_into(">III", boot, HEARTBEAT, 3000, 0, 1_000_000_000)
        struct.pack_into(">I", boot, PACKET, 1400)


def _bound(host: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    made.bind((host, PORT))
    return made


@contextlib.contextmanager
def loopback(wait_s: float = 60.0) -> Iterator[None]:
    """The loopback's camera port for one test process at a time, as it cannot be chosen."""
    deadline_s = time.monotonic() + wait_s
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lock:
        while True:
            try:
                lock.bind("\0fovea-camera-port")
                break
            except OSError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.05)
        yield
