"""One message for every input of the viewer, exposure by exposure."""

from dataclasses import replace

import numpy as np

from pipeline import (
    Detections,
    Frame,
    Header,
    Message,
    Percept,
    RoiSchedule,
    Scanpath,
    Span,
    Tracks,
    Truth,
)
from pipeline.testing import header, picture

BOX = np.array([[100, 100, 140, 160]], np.float32)
ONE = np.ones(1, np.int32)
HALF = np.full(1, 0.5, np.float32)


def traced(seq: int, stage: str) -> Header:
    """Return a header that passed capture and one more stage."""
    told = header(seq)
    ready = told.stamp_ns
    spans = [
        Span(
            stage=name,
            received_ns=ready + 2_000_000 * k,
            done_ns=ready + 2_000_000 * k + 1_500_000,
            handler_ns=1_000_000,
            scheduling_delay_ns=100_000,
        )
        for k, name in enumerate(("capture", stage))
    ]
    return replace(told, trace=tuple(spans))


def exposure(seq: int) -> list[dict[str, Message]]:
    """Return one message for every input."""
    frame = Frame(header=traced(seq, "capture"), pixels=picture(27, 48, seed=seq))
    tracks = Tracks(
        header=traced(seq, "association"),
        ids=np.array([1, 2], np.int32),
        labels=np.array([1, 0], np.int32),
        scores=np.full(2, 0.5, np.float32),
        boxes=np.repeat(np.concatenate([BOX + seq, BOX + 300])[:, None], 4, axis=1),
        visible=np.ones((2, 4), np.bool_),
        features=np.zeros((2, 4, 0), np.float32),
        predicted=np.repeat(np.concatenate([BOX + seq, BOX + 300])[:, None], 16, axis=1),
        names=("ball", "player"),
    )
    told = header(seq)
    return [
        {"context": replace(frame, window=(0, 0, 1920, 1080))},
        {"full": replace(frame, pixels=picture(54, 96, seed=seq), window=(0, 0, 1920, 1080))},
        {"roi": replace(frame, window=(96, 54, 144, 81))},
        {"truth": Truth(header=told, boxes=np.concatenate([BOX + seq, BOX + 500]),
                        ids=np.array([7, 8], np.int32), labels=("player", "player"),
                        visibility=np.ones(2, np.float32))},
        {"detections": Detections(header=told, boxes=BOX, angles=HALF, scores=HALF, labels=ONE,
                                  features=np.zeros((1, 0), np.float32), names=("ball", "player"))},
        {"tracks": tracks},
        {"scanpath": Scanpath(header=traced(seq, "policy"), ids=ONE,
                              probability=np.ones((2, 1), np.float32), choice=np.ones(2, np.int32),
                              boxes=np.repeat(BOX, 2, 0), first_seq=seq + 1)},
        {"schedule": RoiSchedule(header=traced(seq, "dispatch"), first_seq=seq + 1,
                                 windows=BOX.astype(np.int32))},
        {"percept": Percept(header=told, boxes=BOX, ids=ONE, scores=HALF, texts=("EXIT",),
                            action=np.zeros(3, np.float32))},
    ]  # fmt: skip


def part(seq: int, name: str) -> Message:
    """Return the message for one input."""
    return next(given[name] for given in exposure(seq) if name in given)
