"""Decisions of the learned policy that reads: tracks and looks -> candidates -> a plan.

The live graph and the roll-outs of the training share these; only the batch size differs.
"""

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import GazePlan
from operators.policy.memory import recall
from operators.policy.reading.inputs import TextPolicyState, brought_up
from operators.policy.reading.tokens import Texts, encode_scene, encode_texts
from operators.policy.tokens import Array
from pipeline import Tracks


def observe(
    before: TextPolicyState, tracks: Tracks, *, sure: float, delay: int, roi_channels: int
) -> tuple[TextPolicyState, Texts, Array]:
    """Process a frame; return the new state, the candidates and the condition.

    Plans take effect `delay` frames after the one that follows this frame.
    """
    seq, observed = tracks.header.seq, tracks.boxes.shape[1]
    row = seq - before.first_seq
    window = np.zeros(4, np.float32)
    if 0 <= row < len(before.planned):
        window = before.planned[row]
    state, looks = brought_up(before, tracks, delay)
    roi = recall(state.memory, tracks.ids, seq=seq, observed=observed, channels=roi_channels)
    candidates = encode_texts(tracks, looks, roi, sure=sure, delay=delay)
    return state, candidates, encode_scene(tracks, looks, window, sure=sure, delay=delay)


def plan_of(
    tracks: Tracks, candidates: Texts, probability: Array, picked: NDArray[np.intp]
) -> GazePlan:
    """Return the plan that looks at candidate `picked[t]` (Tp,) at step t."""
    over = np.zeros((len(picked), len(tracks.ids)), np.float32)
    track, candidate = np.nonzero(tracks.ids[:, None] == candidates.ids)
    over[:, track] = probability[candidate].T
    return GazePlan(
        choice=candidates.ids[picked],
        boxes=candidates.path[picked, np.arange(len(picked))],
        probability=over,
    )
