"""ALOHA episodes as HDF5: a file in, pictures, joints and actions out; and the other way round.

The layout of ACT and ALOHA: attribute `sim`; `/observations/images/<camera>` (T, h, w, 3) uint8,
`/observations/qpos` and `/observations/qvel` (T, n), `/action` (T, n). The only module that imports
h5py.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import check_size
from drivers.source import Annotations
from pipeline.errors import DriverError
from pipeline.extras import need
from pipeline.text import harmless
from pipeline.whole_file import whole_file

RATE_HZ = 50.0  # the files do not say it
QPOS, QVEL, ACTION = "observations/qpos", "observations/qvel", "action"
IMAGES = "observations/images"
MOST_FRAMES, MOST_COLUMNS = 100_000, 256
MOST_CHUNK_BYTES = 1 << 28  # what is unpacked to read any part of it
OTHERS = "those of other files"
MOST_REASON = 200  # characters of what the library says


class AlohaEpisode:
    """A `FrameSource` of one camera of an episode, with the joints beside it.

    `qpos`, `qvel` and `action` are (T, n) float32: radians, grippers 0 closed .. 1 open.
    """

    shows = "manipulation"

    def __init__(self, *, path: str, camera: str = "top") -> None:
        need("h5py", path)
        self._path, self._file = path, _opened(path)
        try:
            self.simulated = self._simulated()
            self.qpos = self._numbers(QPOS)
            self.qvel, self.action = self._numbers(QVEL), self._numbers(ACTION)
            self._pictures = self._camera(camera)
        except BaseException:
            self.close()
            raise
        frames, height, width, _ = self._pictures.shape
        self.size_px, self.rate_hz = (int(width), int(height)), RATE_HZ
        self.length: int | None = int(frames)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB; IndexError past the end."""
        if not 0 <= index < (self.length or 0):
            raise IndexError(f"{self._path}: no frame {index} in {self.length}")
        try:
            return np.asarray(self._pictures[index], np.uint8)
        except Exception as error:  # a damaged file can raise almost anything
            raise DriverError(
                f"{self._path}: frame {index} of {self.length} cannot be read: {_reason(error)}"
            ) from error

    def truth(self, index: int) -> Annotations | None:
        """Return None: episodes do not say where things are."""
        return None

    def close(self) -> None:
        """Close the file."""
        with suppress(Exception):
            self._file.close()

    def _simulated(self) -> bool:
        try:
            return bool(self._file.attrs.get("sim", False))
        except Exception as error:  # as above; it may be several values, too
            raise DriverError(f"{self._path}: sim: expected true or false, got others") from error

    def _numbers(self, name: str) -> NDArray[np.float32]:
        found = self._dataset(name)
        shape = found.shape
        if len(shape) != 2 or found.dtype.kind != "f" or not 1 <= len(found) <= MOST_FRAMES:
            raise DriverError(
                f"{self._path}: {name}: expected (T, n) numbers, got {found.dtype} {shape}"
            )
        if shape[1] > MOST_COLUMNS:
            raise DriverError(
                f"{self._path}: {name}: expected at most {MOST_COLUMNS} columns, got {shape[1]}"
            )
        try:
            values = np.asarray(found[:], np.float32)
        except Exception as error:  # as above
            raise DriverError(f"{self._path}: {name} cannot be read: {_reason(error)}") from error
        if not np.isfinite(values).all():
            raise DriverError(f"{self._path}: {name}: expected finite numbers, got others")
        if name != QPOS and values.shape != self.qpos.shape:
            raise DriverError(
                f"{self._path}: {name}: expected {self.qpos.shape} as {QPOS} has, got "
                f"{values.shape}"
            )
        return values

    def _camera(self, camera: str) -> Any:
        if camera not in (known := sorted(self._cameras())):
            raise DriverError(
                f"{self._path}: camera: expected one of {', '.join(known)}, got {camera}"
            )
        found = self._dataset(f"{IMAGES}/{camera}")
        shape = found.shape
        if len(shape) != 4 or shape[3] != 3 or found.dtype != np.uint8:
            raise DriverError(
                f"{self._path}: {camera}: expected pictures (T, h, w, 3) uint8, got {shape}; "
                "compressed ones must be unpacked first"
            )
        check_size(f"{self._path}: {camera}", (shape[2], shape[1]))
        if not min(shape[1:3]):
            raise DriverError(f"{self._path}: {camera}: expected pictures, got empty ones")
        if len(found) != len(self.qpos):
            raise DriverError(
                f"{self._path}: {camera}: expected {len(self.qpos)} pictures, got {len(found)}"
            )
        return found

    def _refuse_links(self, name: str) -> None:
        """Raise `DriverError` for what leads to another file, before anything of that is opened."""
        steps = name.split("/")
        for upper in ("/".join(steps[: k + 1]) for k in range(len(steps))):
            try:
                link = self._file.get(upper, getlink=True)
            except Exception as error:  # as above
                raise DriverError(f"{self._path}: expected {name}, got none") from error
            if link is not None and type(link).__name__ != "HardLink":
                raise DriverError(f"{self._path}: {upper}: expected data in the file, got a link")

    def _cameras(self) -> list[str]:
        self._refuse_links(IMAGES)
        try:
            return [str(name) for name in self._file[IMAGES]]
        except Exception as error:  # as above
            raise DriverError(f"{self._path}: expected {IMAGES}, got none") from error

    def _dataset(self, name: str) -> Any:
        self._refuse_links(name)
        try:
            found = self._file[name]
        except Exception as error:  # as above
            raise DriverError(f"{self._path}: expected {name}, got none") from error
        if not isinstance(getattr(found, "shape", None), tuple):  # some data sets are empty
            raise DriverError(f"{self._path}: {name}: expected numbers, got none")
        if found.external or found.is_virtual:
            raise DriverError(f"{self._path}: {name}: expected numbers in the file, got {OTHERS}")
        if found.chunks and math.prod(found.chunks) * found.dtype.itemsize > MOST_CHUNK_BYTES:
            raise DriverError(
                f"{self._path}: {name}: expected chunks of at most {MOST_CHUNK_BYTES} bytes, got "
                f"{found.chunks} of {found.dtype}"
            )
        return found


def write_episode(
    path: Path,
    *,
    pictures: Mapping[str, NDArray[np.uint8]],
    qpos: NDArray[np.float32],
    qvel: NDArray[np.float32],
    action: NDArray[np.float32],
) -> None:
    """Write a simulated episode, whole or not at all: pictures (T, h, w, 3) by camera."""
    need("h5py", str(path))
    import h5py

    with whole_file(path) as file, h5py.File(file, "w") as out:
        out.attrs["sim"] = True
        for name, values in ((QPOS, qpos), (QVEL, qvel), (ACTION, action)):
            out.create_dataset(name, data=values)
        for camera, shown in pictures.items():
            out.create_dataset(
                f"{IMAGES}/{camera}", data=shown, chunks=(1, *shown.shape[1:]), compression="lzf"
            )


def _opened(path: str) -> Any:
    import h5py

    if not Path(path).is_file():
        raise DriverError(f"{path}: expected an episode as HDF5, got no such file")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise DriverError(
            f"{path}: expected an episode as HDF5, got a file that is another or cut short, to be "
            f"copied or recorded anew: {_reason(error)}"
        ) from error


def _reason(error: Exception) -> str:
    return harmless(str(error), MOST_REASON)
