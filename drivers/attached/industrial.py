"""Look for industrial cameras through Aravis: what is attached and what each can do out."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from drivers.attached.listing import AttachedSensor, Offer
from drivers.attached.permissions import hidden_cameras
from drivers.genicam.discovery import AttachedCamera, discover
from drivers.genicam.foveation import Foveation

FOVEATED = "genicam_foveated --set capture.camera"
PLAIN = "genicam --set capture.camera_options.camera"


def look() -> Iterator[dict[str, Any]]:
    """Yield every camera, as it describes itself; raises `InstallError` without Aravis.

    Aravis does not list USB3 Vision cameras that may not be opened: they follow, with the remedy.
    """
    for found in discover():
        yield asdict(described(found))
    for hidden in hidden_cameras():
        yield asdict(hidden)


def described(found: AttachedCamera) -> AttachedSensor:
    """Return a camera as the list shows it."""
    aim, foveates = found.foveation, bool(found.foveation.means)
    low, high = found.rates_hz
    rates_hz = (low, high) if 0 < low <= high else ()
    return AttachedSensor(
        name=f"genicam:{found.id}",
        title=f"{found.vendor} {found.model}".strip() or "a camera that does not tell its name",
        where=f"{found.protocol} {found.address}".strip(),
        offers=tuple(
            Offer(pixel_format=name, size_px=found.field_px, rates_hz=rates_hz, ranged=True)
            for name in found.pixel_formats
        ),
        modes=("plain", "foveated")[: 1 + foveates] if found.pixel_formats else (),
        roi_sizes_px=aim.roi_sizes_px(),
        foveates=foveates,
        foveation=_how(aim),
        run=f"fovea run tracking --source {FOVEATED if foveates else PLAIN}={found.id}",
        problem=found.problem,
    )


def _how(aim: Foveation) -> str:
    if not aim.means:
        return aim.reason
    reduction = aim.reduction.lower()
    if aim.means == "writes":
        return f"context and ROI in turns, by writing {reduction} and offset between frames"
    return f"context and ROI in turns, by {aim.sets} stored sets of {reduction} and offset"
