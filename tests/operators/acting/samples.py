"""Frames, tracks and networks for tests of the policy that acts."""

from pathlib import Path

import numpy as np

from drivers.robot import Joints
from pipeline import Frame, Geometry, Header, Tracks

FIELD = Geometry(width_px=640, height_px=480, roi_width_px=160, roi_height_px=120, step_px=1)
CONTEXT = (82, 109, 3)  # shape


def header(seq: int = 0, stream: str = "trial") -> Header:
    return Header(stream=stream, seq=seq, stamp_ns=seq, geometry=FIELD)


def tracks(boxes: list[list[float]], seq: int = 0, channels: int = 2) -> Tracks:
    each = np.array(boxes, np.float32).reshape(-1, 4)
    count = len(each)
    return Tracks(
        header=header(seq),
        ids=np.arange(3, 3 + count, dtype=np.int32),
        labels=np.zeros(count, np.int32),
        scores=np.full(count, 0.5, np.float32),
        boxes=np.repeat(each[:, None], 4, axis=1),
        visible=np.ones((count, 4), np.bool_),
        features=np.ones((count, 4, channels), np.float32),
        predicted=np.repeat(each[:, None], 16, axis=1),
    )


def context(seq: int = 0, level: int = 100) -> Frame:
    return Frame(
        header=header(seq), pixels=np.full(CONTEXT, level, np.uint8), window=(0, 0, 640, 480)
    )


def roi(window: tuple[int, int, int, int], seq: int = 0) -> Frame:
    return Frame(header=header(seq), pixels=np.zeros((84, 112, 3), np.uint8), window=window)


def joints(seq: int = 0, count: int = 14) -> Joints:
    still = np.zeros(count, np.float32)
    return Joints(header=header(seq), positions=still, velocities=still)


def network(path: Path, *, channels: int = 2, seed: int = 1) -> Path:
    import torch

    from operators.acting.model import ActingNet, export

    torch.manual_seed(seed)
    export(ActingNet(channels=channels), path)
    return path
