"""Logistic regression: what each input is worth for an outcome."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

Array = NDArray[np.float64]


def regressed(inputs: Array, outcome: NDArray[np.bool_], penalty: float) -> Array:
    """Return a weight for each input (n, k) and, last, a constant: (k + 1,).

    Minimised is the cross-entropy of the outcome (n,), summed, and `penalty` times the squares of
    the weights, without the constant.
    """
    known = np.column_stack([inputs, np.ones(len(inputs))])
    signs = np.where(outcome, -1.0, 1.0)
    costs = np.append(np.full(inputs.shape[1], penalty), 0.0)

    def loss(weights: Array) -> tuple[float, Array]:
        against = signs * (known @ weights)
        slope = known.T @ (signs * expit(against)) + 2 * costs * weights
        value = np.logaddexp(0, against).sum() + (costs * weights**2).sum()
        return float(value) / len(known), slope / len(known)

    start = np.zeros(known.shape[1])
    found = minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-8})
    return np.asarray(found.x, np.float64)
