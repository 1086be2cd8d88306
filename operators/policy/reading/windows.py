"""Windows that show several texts: boxes and their worth -> for each text its best window."""

import numpy as np
from numpy.typing import NDArray

from pipeline import Geometry
from pipeline.boxes import Array, areas, centres, from_centres, in_parts, intersections

MARGIN_PX = 5.0  # around a text: one that touches the window's edge is read half as often
WHOLE = 0.98  # share of a box and its margin that a window must show
NEARER = 1e-3  # worth of a text in the middle of its window


def around(boxes: Array, worth: Array, geometry: Geometry) -> tuple[Array, NDArray[np.bool_]]:
    """Return for each text a window that shows it and what is worth most beside it.

    From boxes (n, 4) and worths (n,): the centres of the windows (n, 2), and which texts each of
    them shows (n, n). Tried are windows around the text, and between it and any other.
    """
    count = len(boxes)
    if not count:
        return np.zeros((0, 2), np.float32), np.zeros((0, 0), np.bool_)
    middle, own = centres(boxes), np.arange(count)
    roi: Array = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    field: Array = np.array([geometry.width_px, geometry.height_px], np.float32)
    margin: Array = np.array([-MARGIN_PX, -MARGIN_PX, MARGIN_PX, MARGIN_PX], np.float32)
    grown: Array = boxes + margin
    first, second = np.nonzero(own[:, None] <= own)
    places: Array = (middle[first] + middle[second]) / np.float32(2)
    if field.all():  # a window is inside the field
        places = np.clip(places, roi / 2, field - roi / 2)
        grown = np.clip(grown, 0, np.tile(field, 2))
    # a window without the middle of a text does not show it
    away = [np.abs(centres(grown)[text] - places) for text in (first, second)]
    kept = (np.minimum(*(np.max(each / roi, axis=1) for each in away)) <= 0.5) | (first == second)
    first, second, places = first[kept], second[kept], places[kept]
    windows = from_centres(places, np.broadcast_to(roi, places.shape))
    least = np.asarray(WHOLE * np.maximum(areas(grown), 1e-9), np.float32)
    pairs = np.stack([first, second], 1)
    itself, shown = compared(windows, grown, least, worth.astype(np.float32), pairs)
    shown[first == second] += np.float32(NEARER)
    gain: Array = np.full((count, count), -1, np.float32)  # of what does not show the text itself
    window: NDArray[np.intp] = np.zeros((count, count), np.intp)
    for text, other, shows in ((first, second, itself[:, 0]), (second, first, itself[:, 1])):
        gain[text, other] = np.where(shows, shown, -1)
        window[text, other] = np.arange(len(text))
    best = gain.argmax(1)
    best = np.where(gain[own, best] < 0, own, best)  # larger than a window
    chosen = window[own, best]
    return places[chosen], np.asarray(intersections(windows[chosen], grown) >= least)


def compared(
    windows: Array, boxes: Array, least: Array, worth: Array, pairs: NDArray[np.intp]
) -> tuple[NDArray[np.bool_], Array]:
    """Return which of its two texts each window shows (m, 2), and what all it shows is worth (m,).

    `least` (n,) is the area of each box that a window must show, `pairs` (m, 2) are rows of boxes.
    """
    own, found, begin = [], [], 0
    for part in in_parts(windows, len(boxes)):
        shows = intersections(part, boxes) >= least
        own.append(np.take_along_axis(shows, pairs[begin : begin + len(part)], 1))
        found.append(shows @ worth)
        begin += len(part)
    return np.concatenate(own), np.concatenate(found)
