"""Kinds of virtual boards: what each can do, and how long it takes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from drivers.usb.capabilities import BoardCapabilities, CaptureMode, RoiSize
from pipeline.pixel_formats import FORMATS
from pipeline.planner.links import LINKS

USB3_BYTES_PER_S = round(LINKS["usb3.0"].carries_bytes_per_s)  # what a camera reaches in practice
# PFNC codes of what a colour sensor sends whose first pixel is red
CODES = tuple(form.code for form in FORMATS.values() if form.name == "rgb8" or form.order == "rggb")


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A kind of board."""

    can: BoardCapabilities
    readout_frames: float = 0.0  # from the exposure to the first byte that a host can read
    buffer_frames: int = 4  # that wait for the host; then the oldest is dropped
    paced: bool = False  # whether the link takes the time of its bytes


def _board(size_px: tuple[int, int], context: int, *rois: RoiSize, **more: object) -> Profile:
    width, height = size_px
    values: dict[str, object] = {
        "width_px": width, "height_px": height,
        "context_px": (width // context, height // context), "step_px": 2, "lead_frames": 1,
        "modes": (CaptureMode.LIVE,), "rates_mhz": (100, 1_000_000), "preview_mhz": 0,
        "burst_frames": 0, "link_bytes_per_s": USB3_BYTES_PER_S, "roi_sizes": rois,
        "formats": CODES, "model": "fovea virtual board", "serial": "V0001",
        "firmware": "1.0",
    }  # fmt: skip
    known = {key: more.pop(key) for key in list(more) if key in values}
    can = BoardCapabilities(**{**values, **known})  # type: ignore[arg-type]
    return Profile(can=can, **more)  # type: ignore[arg-type]


PAPER_PX = (16_320, 9_184)
PAPER_ROIS = (RoiSize(4080, 2296), RoiSize(8160, 4592, 2))

_PROTOTYPE = _board(
    PAPER_PX, 8, *PAPER_ROIS, modes=(CaptureMode.RECORD,), rates_mhz=(30_000, 30_000),
    preview_mhz=7_500, burst_frames=105, readout_frames=28.7, paced=True,
)  # fmt: skip
# 28.7 frames of read-out and 31.3 of the paper's host (supplement "Hardware Prototype")
PAPER_DELAY_FRAMES = 60

PROFILES: Mapping[str, Profile] = MappingProxyType(
    {
        # nothing takes time: what a link and a sensor without limits would do
        "ideal": _board(
            (1920, 1080), 4, RoiSize(480, 270), RoiSize(960, 540, 2), link_bytes_per_s=0
        ),
        # the paper's geometry, as if its board could stream both pictures live
        "paper-live": _board(
            PAPER_PX, 8, *PAPER_ROIS, rates_mhz=(1000, 30_000), readout_frames=1.0, paced=True
        ),
        # the paper's board: 7.5 previews a second, 28.7 frames of read-out, bursts of 105 frames
        "paper-prototype": _PROTOTYPE,
        # the same before the paper's host, which is slower than this one: a plan is obeyed as late
        # as the paper's was, however early it comes
        "paper-prototype-slow-host": replace(
            _PROTOTYPE, can=replace(_PROTOTYPE.can, lead_frames=PAPER_DELAY_FRAMES)
        ),
    }
)  # fmt: skip
