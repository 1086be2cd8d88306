"""A constant-velocity Kalman filter for many boxes at once (paper, section 3.3 and supplement).

The state of one object is its centre and velocity (x, y, vx, vy). The two axes share one model and
are independent, so the 4x4 covariance reduces to one 2x2 block, and n filters are a few arrays.

The paper gives process noise 0.001 and measurement noise 0.01 without units. What the units do:

- Length cancels. Gains depend on the ratio of the two noises alone; pixels, picture widths or box
  sizes give the same estimate. We take the box size (root of its area), because then the numbers
  mean something: a detector errs by sqrt(0.01) = 0.1 of the box, and an object changes its speed by
  sqrt(0.001) = 0.03 boxes per frame in each frame. The covariance is kept in that unit.
- Time does not cancel. With time in frames (25 Hz footage) the error of a prediction over 4 frames
  is 6.5 px for people, with time in seconds 19 to 78 px (`python -m bench.kalman`): frames.
- Read as standard deviations (ratio 0.01) the filter is slower: better on noisy boxes of people,
  worse on a ball; read as variances, as here, it follows the ball.
- Process noise on the acceleration (filterpy's discrete white noise) or the same number on every
  state variable: no difference beyond 2 %.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIRST_SPEED_VARIANCE = 1.0  # (boxes / frame)^2: a new object may move its own size per frame


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """The matrices of one axis; time in frames, length in box sizes."""

    transition: Array  # (2, 2)
    process: Array  # (2, 2), noise added per frame
    measurement: float  # variance of one measured centre
    first: Array  # (2, 2), covariance of an object seen once


def motion_model(process_noise: float, measurement_noise: float) -> MotionModel:
    """The model for the paper's two numbers, both read as variances."""
    return MotionModel(
        transition=np.array([[1.0, 1.0], [0.0, 1.0]]),
        process=np.array([[0.25, 0.5], [0.5, 1.0]]) * process_noise,  # of a white acceleration
        measurement=measurement_noise,
        first=np.diag([measurement_noise, FIRST_SPEED_VARIANCE]),
    )


def predict(mean: Array, covariance: Array, model: MotionModel) -> tuple[Array, Array]:
    """Predict one frame ahead: means (n, 4) in pixels, covariances (n, 2, 2) in box sizes.

    Repeat it for a step of several frames, as for frames without detections.
    """
    ahead = np.concatenate([mean[:, :2] + mean[:, 2:], mean[:, 2:]], axis=1)
    f = model.transition
    return ahead, f @ covariance @ f.T + model.process


def update(
    mean: Array, covariance: Array, measured: Array, model: MotionModel
) -> tuple[Array, Array]:
    """Update with one measured centre each: means (n, 4), covariances (n, 2, 2), centres (n, 2)."""
    gain = covariance[:, :, 0] / (covariance[:, 0, 0] + model.measurement)[:, None]  # (n, 2)
    residual = measured - mean[:, :2]
    corrected = mean + np.concatenate([gain[:, :1] * residual, gain[:, 1:] * residual], axis=1)
    return corrected, covariance - gain[:, :, None] * covariance[:, None, 0, :]


def extrapolate(mean: Array, frames: NDArray[np.int64]) -> Array:
    """Centres `frames` ahead: means (n, 4), (t,) -> (n, t, 2), pixels."""
    steps = frames[None, :, None]
    return np.asarray(mean[:, None, :2] + steps * mean[:, None, 2:])
