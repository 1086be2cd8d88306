"""Boxes of messages as Foxglove draws them over a picture: message -> `ImageAnnotations`.

The boxes are in sensor pixels and the picture shows the whole field, so that only its size counts.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.messages import Detections, Message, Percept, RoiSchedule, Tracks, Truth
from pipeline.recording import foxglove
from pipeline.text import harmless

LINE_PX, FONT_PX = 1.5, 10.0  # of the picture
MOST_BOXES, MOST_CHARS = 1000, 60
COLOURS = {  # by type of message: red, green, blue
    Detections: (0.6, 0.6, 0.6), Tracks: (1.0, 0.65, 0.0), Percept: (1.0, 0.2, 0.2),
    Truth: (1.0, 1.0, 1.0), RoiSchedule: (1.0, 0.9, 0.0),
}  # fmt: skip


class _Named(NamedTuple):
    boxes: NDArray[Any]  # (n, 4), xyxy, sensor pixels
    names: Sequence[str]  # n, or none


def annotations(message: Message, picture_px: tuple[int, int]) -> bytes | None:
    """Return a message's boxes for a picture of this width and height, none of them as well.

    None where a message has no boxes to draw, or where sensor or picture have no known size.
    """
    found, geometry = _named(message), message.header.geometry
    if found is None or not (geometry.width_px and geometry.height_px and all(picture_px)):
        return None
    scale = np.array(picture_px) / (geometry.width_px, geometry.height_px)
    drawn = foxglove.message(foxglove.ANNOTATIONS)()
    drawn.timestamp.FromNanoseconds(message.header.stamp_ns)
    colour = dict(zip("rgba", (*COLOURS[type(message)], 1.0), strict=True))
    corners = found.boxes[:MOST_BOXES, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2) * scale
    for row, points in enumerate(corners.tolist()):
        box = drawn.points.add(type=foxglove.LINE_LOOP, thickness=LINE_PX, outline_color=colour)
        box.timestamp.FromNanoseconds(message.header.stamp_ns)
        for x, y in points:
            box.points.add(x=x, y=y)
        if row < len(found.names):
            text = drawn.texts.add(
                text=harmless(found.names[row], MOST_CHARS), font_size=FONT_PX, text_color=colour,
                position={"x": points[0][0], "y": points[0][1]},
            )  # fmt: skip
            text.timestamp.FromNanoseconds(message.header.stamp_ns)
    return bytes(drawn.SerializeToString())


def _named(message: Message) -> _Named | None:
    if isinstance(message, Detections):
        known = message.names
        names = [known[i] if 0 <= i < len(known) else f"class {i}" for i in message.labels]
        scored = zip(names, message.scores, strict=True)
        return _Named(message.boxes, [f"{name} {score:.2f}" for name, score in scored])
    if isinstance(message, Tracks):
        names = [f"{message.name_of(row)} #{i}".strip() for row, i in enumerate(message.ids)]
        return _Named(message.boxes[:, -1], names)
    if isinstance(message, Truth):
        return _Named(message.boxes, message.labels)
    if isinstance(message, Percept):
        return _Named(message.boxes, message.texts)
    if isinstance(message, RoiSchedule) and len(message.windows):
        windows = message.windows[:1].reshape(-1, 4)  # of the next frame
        return _Named(windows[windows[:, 2] > windows[:, 0]], ())
    return None
