"""Utility of a plan that reads: the number of texts that it is expected to read, sooner is better.

A window at step t reads text j with chance q[j, t] if it shows it. What was read is worth nothing
more, so that a plan is worth a set coverage: the sum over texts of 1 - prod over steps of
(1 - sum over candidates of p[i, t] q[i, j, t]). `DISCOUNT` per step asks for it soon: without it,
a plan may put off a text in every frame anew.
"""

import numpy as np

from operators.policy.tokens import Array

DISCOUNT = 0.97


def expected(reads: Array, left: Array, probability: Array) -> float:
    """Return the utility of a plan (N, Tp): chances (N, J, Tp) -> texts.

    `left` (J,) is the chance that a text is still to be read when the plan takes effect.

    >>> expected(np.ones((1, 1, 2)), np.array([0.5]), np.ones((1, 2)))
    0.5
    """
    total = 0.0
    for step in range(reads.shape[2]):
        read = left * (probability[:, step] @ reads[:, :, step])
        total += DISCOUNT**step * float(read.sum())
        left = left - read
    return total


def marginal(reads: Array, left: Array) -> Array:
    """Return what each candidate adds at each step of the greedy plan: (N, J, Tp) -> (N, Tp).

    `left` is as above. The greedy plan takes the best candidate at each step, given what the steps
    before have read.
    """
    gained = np.zeros((reads.shape[0], reads.shape[2]), np.float32)
    for step in range(reads.shape[2]):
        gained[:, step] = reads[:, :, step] @ left
        best = int(gained[:, step].argmax())
        left = left * (1 - reads[best, :, step])
    return gained
