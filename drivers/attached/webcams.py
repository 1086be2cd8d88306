"""Look for webcams: devices of V4L2 in, what each can do out."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from drivers.attached.listing import AttachedSensor, Offer
from drivers.cameras.offers import offers
from drivers.cameras.v4l2 import NAMES, NoCamera, look_at, numbers
from pipeline.errors import DriverError

BY_ID = Path("/dev/v4l/by-id")
FOVEATION = "it sends whole frames; context and ROI are cut from them in software"
RUN = "fovea run follow --source webcam --set capture.camera_options.device="


def look(names: str = "") -> Iterator[dict[str, Any]]:
    """Yield every device that captures; `names` is the folder of the kernel's list of them."""
    for number in numbers(Path(names) if names else NAMES):
        path = f"/dev/video{number}"
        try:
            found = _described(path, look_at(path))
        except NoCamera:  # many webcams have a second device, for data about pictures
            continue
        except DriverError as error:  # one that another program uses tells all the same
            found = replace(_described(path, "a video device"), problem=str(error))
        yield asdict(found)


def _described(path: str, title: str) -> AttachedSensor:
    try:
        listed = offers(path)
    except DriverError:  # `look_at` has told why
        listed = ()
    found = tuple(
        Offer(
            pixel_format=one.fourcc, size_px=one.size_px, rates_hz=one.rates_hz, ranged=one.ranged
        )
        for one in listed
    )
    return AttachedSensor(
        name=path,
        title=title,
        where=by_id(path),
        offers=found,
        modes=("plain",),
        foveation=FOVEATION,
        run=f"{RUN}{path}",
    )


def by_id(path: str, folder: Path = BY_ID) -> str:
    """Return the path of a device that survives replugging; empty: it has none."""
    try:
        found = sorted(link for link in folder.iterdir() if str(link.resolve()) == path)
    except OSError:
        return ""
    return str(found[0]) if found else ""
