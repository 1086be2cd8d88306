"""The driver's transfers over a modelled host controller: `model.c` as a library and as a link."""

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import cast

import numpy as np
from numpy.typing import NDArray

from drivers.usb.frame_header import FrameFlag, FrameHeader, Stream, WindowStatus
from drivers.usb.link import CHUNK_BYTES, Link
from drivers.usb.losses import Losses
from drivers.usb.part import Part
from drivers.usb.receiver import Receiver
from drivers.usb.transfers import InFlight
from pipeline.errors import DriverError
from pipeline.pixel_formats import FORMATS

SOURCE = Path(__file__).with_name("model.c")
ENDPOINTS = (0x81, 0x82)
FORM = FORMATS["bayer_rggb8"]


def compiled(folder: Path) -> ctypes.CDLL:
    """Compile the model; raises `DriverError` without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise DriverError("usb model: expected a C compiler (cc), found none")
    library = folder / "model.so"
    command = [compiler, "-shared", "-fPIC", "-O2", "-pthread", "-o", str(library), str(SOURCE)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if done.returncode:
        raise DriverError(f"usb model: cannot be compiled: {done.stderr.strip().splitlines()[0]}")
    return ctypes.CDLL(str(library))


class ModelLink:
    """A link whose board always has a frame; the only part of `Link` that a `Receiver` uses."""

    def __init__(
        self, library: ctypes.CDLL, sizes_px: Sequence[tuple[int, int]], *, depth: int,
        bytes_per_s: float,
    ) -> None:  # fmt: skip
        self._library = library
        headers = [_header(stream, size) for stream, size in zip(Stream, sizes_px, strict=True)]
        self.payload_bytes = {h.stream: h.payload_bytes for h in headers}
        payloads = (ctypes.c_longlong * 2)(*self.payload_bytes.values())
        library.model_start(
            b"".join(h.pack() for h in headers), payloads, ctypes.c_double(bytes_per_s)
        )
        self._reads = InFlight(
            library, None, None, ENDPOINTS, chunk_bytes=CHUNK_BYTES, depth=depth
        )  # fmt: skip

    def receiver(self) -> Receiver:
        """Return the driver's receiver over this link."""
        return Receiver(cast(Link, self), self.payload_bytes, Losses())

    def receive(self, parts: Sequence[Part], timeout_s: float, ahead: Sequence[Part] = ()) -> None:
        """Fill parts, as `Link.receive` does."""
        self._reads.receive(parts, timeout_s, ahead)

    def cancel(self, stream: int) -> None:
        """End the reads of a stream, as `Link.cancel` does."""
        self._reads.cancel(stream)

    @property
    def bytes(self) -> int:
        """What the link has carried."""
        self._library.model_bytes.restype = ctypes.c_longlong
        return int(self._library.model_bytes())

    def gaps_ms(self) -> NDArray[np.float64]:
        """How long the link waited for a read, before each transfer but the first."""
        found = ctypes.POINTER(ctypes.c_double)()
        count = self._library.model_gaps(ctypes.byref(found))
        return np.ctypeslib.as_array(found, (count,)).copy() if count else np.empty(0)

    def __enter__(self) -> "ModelLink":
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._reads.close()
        self._library.model_stop()


def _header(stream: Stream, size_px: tuple[int, int]) -> FrameHeader:
    width, height = size_px
    row_bytes = FORM.row_bytes(width)
    return FrameHeader(
        stream=stream, flags=FrameFlag(0), window_status=WindowStatus.OK, exposure=0, stamp_ns=0,
        window=(0, 0, width, height), size_px=size_px, pixel_format=FORM.code,
        row_bytes=row_bytes, payload_bytes=row_bytes * height, payload_crc=0, schedule_id=0,
        entry=0, dropped=0,
    )  # fmt: skip
