"""What a window is worth to the consumer: a full picture and windows in, changes of the action out.

The utility of the manipulation task: minus the change of the action against full resolution. It
needs no labels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.readout import average, scaled
from operators.manipulation.network import ActNetwork
from operators.manipulation.picture import place

Window = tuple[int, int, int, int]  # xyxy, sensor pixels; without area: none is read
NOTHING: Window = (0, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class Acquisition:
    """What the sensor reads beside a window: the paper's, for a sixteenth of the pixels."""

    context_scale: float = 0.17
    roi_scale: float = 0.7


def view(
    net: ActNetwork, picture: NDArray[np.uint8], window: Window, how: Acquisition
) -> NDArray[np.uint8]:
    """Return what the consumer sees of a full picture (h, w, 3) through context and a window."""
    field = picture.shape[1], picture.shape[0]
    width, height = net.picture_px
    out = np.zeros((height, width, 3), np.uint8)
    place(_read(picture, how.context_scale), (0, 0, *field), field, out, net.workplace)
    left, top, right, bottom = window
    if right > left and bottom > top:
        shown = _read(picture[top:bottom, left:right], how.roi_scale)
        place(shown, window, field, out, net.workplace)
    return out


def changes(
    net: ActNetwork,
    picture: NDArray[np.uint8],
    joints: NDArray[np.float32],
    windows: Sequence[Window],
    how: Acquisition,
) -> NDArray[np.float32]:
    """Return the mean absolute change (n,) of the chunk through each window, in joint units."""
    field = picture.shape[1], picture.shape[0]
    whole = np.zeros((net.picture_px[1], net.picture_px[0], 3), np.uint8)
    place(picture, (0, 0, *field), field, whole, net.workplace)
    wanted = net(whole, joints)
    told = [net(view(net, picture, window, how), joints) for window in windows]
    return np.array([np.abs(each - wanted).mean() for each in told], np.float32)


def _read(region: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    width, height = scaled((region.shape[1], region.shape[0]), scale)
    out = np.empty((height, width, 3), np.uint8)
    average(region, out)
    return out
