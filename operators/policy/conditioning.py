"""Encode the target for the network: the condition, and the prompted position as a candidate.

The paper conditions on the features at the target's first position and on its box. Here it is the
target's last estimated box (`target.py`).

The position itself is also a candidate while the target is not in view. This is our addition: a
still ball at the corner flag stays below the detector's threshold, and only the prompt tells where
it is.
"""

import numpy as np
from numpy.typing import NDArray

from operators.policy.carrier import carried_motion
from operators.policy.gaze_plan import PLACE, row_of
from operators.policy.motion import camera_motion
from operators.policy.target import TargetSpec, TargetState, alike, carrier_row, unknown_label
from operators.policy.tokens import BOX, CLASSES, Array, Objects, encode_boxes, encode_labels
from pipeline import Tracks

CHANNELS = 64  # of the detector's feature map
CONDITION = CHANNELS + BOX + CLASSES + 4
GRACE = 8  # frames without a matching track before a warning


def encode_condition(target: TargetState, spec: TargetSpec, tracks: Tracks) -> Array:
    """Return the condition (CONDITION,): features, box, class and state of the target."""
    encoded = np.zeros(CONDITION, np.float32)
    encoded[: min(len(target.features), CHANNELS)] = target.features[:CHANNELS]
    if target.placed:
        encoded[CHANNELS : CHANNELS + BOX] = encode_boxes(target.box, tracks.header.geometry)
    encoded[CHANNELS + BOX : -4] = encode_labels(tracks.names, [target.label or spec.label])[0]
    row = row_of(tracks, target.bound_id)
    unseen = tracks.header.seq - target.seen_seq if target.seen_seq >= 0 else 0
    encoded[-4:] = (
        spec.one,
        bool(spec.label),
        row >= 0 and tracks.visible[row, -1],
        min(unseen / 16, 2),
    )
    return encoded


def unmet(target: TargetState, spec: TargetSpec, tracks: Tracks) -> str:
    """Return a sentence when no track matches the prompt, else an empty string."""
    if sentence := unknown_label(spec.label, tracks.names):
        return sentence
    seq = tracks.header.seq
    if not spec.one or target.bound_id >= 0 or seq - target.asked_seq < GRACE:
        return ""
    frames = f"frames {target.asked_seq} to {seq}"
    if spec.boxed:
        return f"policy.prompt_box: expected a track at {spec.box}, none was there in {frames}"
    return f"policy.target_id: expected a track {spec.object_id}, none was there in {frames}"


def encode_place(
    target: TargetState, spec: TargetSpec, tracks: Tracks, looks: Array, *, patience: int
) -> Objects | None:
    """Return the prompted position as a candidate; None while in view, or after `patience`.

    A position at a carrier remains a candidate for longer. `looks` (To, D) are the target's recent
    ROI features.
    """
    unseen = tracks.header.seq - target.seen_seq
    row, carrier = row_of(tracks, target.bound_id), carrier_row(target, tracks)
    if not target.placed or (row >= 0 and tracks.visible[row, -1]):
        return None
    if carrier < 0 and unseen > patience:
        return None
    observed, horizon = tracks.boxes.shape[1], tracks.predicted.shape[1]
    motion = camera_motion(tracks)
    moved = np.arange(1 - observed, 1, dtype=np.float32)[:, None] * motion
    moves = np.arange(1, horizon + 1, dtype=np.float32)[:, None] * motion
    if carrier >= 0:
        moved, moves = carried_motion(tracks, carrier)
    path = (target.box + np.tile(moves, 2)).astype(np.float32)
    past = encode_boxes((target.box + np.tile(moved, 2)).astype(np.float32), tracks.header.geometry)
    features = np.zeros(tracks.features.shape[2], np.float32)
    features[: len(target.features)] = target.features
    return Objects(
        ids=np.array([PLACE], np.int32),
        roi=looks[None],
        context=np.broadcast_to(features, (1, observed, len(features))).copy(),
        boxes=np.concatenate([past, np.zeros((observed, 1), np.float32)], 1)[None],
        predicted=encode_boxes(path, tracks.header.geometry)[None],
        label=encode_labels(tracks.names, [target.label or spec.label]),
        place=np.ones(1, np.float32),
        path=path[None],
    )


def unlike(
    target: TargetState, spec: TargetSpec, tracks: Tracks, ids: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return which candidates (n,) differ too much in size from the prompted box.

    Before a box is bound to a track, only its size is known; later also features, class and motion.
    """
    refused = np.zeros(len(ids), np.bool_)
    if spec.boxed and target.bound_id < 0 and target.placed:
        other = tracks.ids[~alike(tracks.boxes[:, -1], target.box)]
        refused = np.isin(ids, other)
    return refused
