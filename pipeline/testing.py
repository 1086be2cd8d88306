"""Drive one operator by hand: messages in, its answers out. For tests and notebooks."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pipeline.contract import Operator, handler_of, joined, settings_of
from pipeline.messages import Geometry, Header, Message


def header(seq: int = 0, *, stream: str = "test", geometry: Geometry | None = None) -> Header:
    """A header for a made-up exposure; the field is 1920x1080 with a 480x270 ROI."""
    full_hd = Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270)
    return Header(stream=stream, seq=seq, stamp_ns=seq * 33_333_333, geometry=geometry or full_hd)


def drive(
    operator: type[Operator[Any, Any]],
    messages: Iterable[Message | Mapping[str, Message]],
    settings: Mapping[str, Any] | None = None,
) -> list[Any]:
    """Open the operator, hand it each message (or each set by input name), close it.

    A single message goes to the joined set; a mapping whose only key is an unjoined input goes
    to that input. Returns what the handlers answered, None for explicit nothing.
    """
    subject = operator(settings_of(operator)(**(settings or {})))
    names = joined(operator)
    answers = []
    stream = ""
    try:
        subject.open()
        for message in messages:
            given = {names[0]: message} if isinstance(message, Message) else dict(message)
            seen = next(iter(given.values())).header
            if seen.stream != stream:
                subject.on_stream(seen)
                stream = seen.stream
            wanted = names if set(given) & set(names) else tuple(given)
            arguments = {name: given.get(name) for name in wanted}
            answers.append(handler_of(subject, wanted)(**arguments))
    finally:
        subject.close()
    return answers


def picture(height_px: int, width_px: int, *, seed: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A random RGB picture (h, w, 3)."""
    return np.random.default_rng(seed).integers(0, 256, (height_px, width_px, 3), np.uint8)
