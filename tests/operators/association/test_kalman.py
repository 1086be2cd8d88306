"""The batched filter agrees with filterpy's filter of one object."""

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from operators.association.kalman import extrapolate, motion_model, predict, update


def reference(process_noise: float, measurement_noise: float, start: np.ndarray) -> KalmanFilter:
    """Return filterpy's filter of the same model: state x, y, vx, vy."""
    model = motion_model(process_noise, measurement_noise)
    both = np.eye(2)
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.F, kalman.Q = np.kron(model.transition, both), np.kron(model.process, both)
    kalman.H, kalman.R = np.eye(2, 4), np.eye(2) * model.measurement
    kalman.P = np.kron(model.first, both)
    kalman.x = np.concatenate([start, np.zeros(2)])
    return kalman


@pytest.mark.parametrize(("process_noise", "measurement_noise"), [(0.001, 0.01), (0.5, 0.02)])
def test_the_batched_filter_is_filterpys_filter(process_noise, measurement_noise):
    rng = np.random.default_rng(3)
    walks = rng.normal(size=(12, 5, 2)).cumsum(0) * 20  # 12 frames, 5 objects
    singles = [reference(process_noise, measurement_noise, start) for start in walks[0]]
    model = motion_model(process_noise, measurement_noise)
    mean = np.concatenate([walks[0], np.zeros((5, 2))], axis=1)
    covariance = np.tile(model.first, (5, 1, 1))

    for k, measured in enumerate(walks[1:]):
        mean, covariance = predict(mean, covariance, model)
        for single in singles:
            single.predict()
        if k % 4 != 2:  # one frame in four has no measurement
            mean, covariance = update(mean, covariance, measured, model)
            for single, z in zip(singles, measured, strict=True):
                single.update(z)

    np.testing.assert_allclose(mean, [single.x for single in singles], rtol=1e-9)
    blocks = [single.P[::2, ::2] for single in singles]
    np.testing.assert_allclose(covariance, blocks, rtol=1e-9, atol=1e-12)


def test_a_steady_object_is_predicted_where_it_will_be():
    model = motion_model(0.001, 0.01)
    mean, covariance = np.array([[10.0, 20, 0, 0]]), model.first[None]

    for k in range(1, 30):
        mean, covariance = predict(mean, covariance, model)
        mean, covariance = update(mean, covariance, np.array([[10.0 + 3 * k, 20 - k]]), model)

    ahead = extrapolate(mean, np.array([1, 10]))
    np.testing.assert_allclose(ahead[0], [[100, -10], [127, -19]], atol=0.05)


def test_the_unit_of_length_cancels():
    model, scale = motion_model(0.001, 0.01), 1920.0
    small = np.array([[0.1, 0.2, 0, 0], [0.5, 0.5, 0, 0]])
    measured = np.array([[0.11, 0.2], [0.4, 0.55]])
    covariance = np.tile(model.first, (2, 1, 1))

    in_widths, _ = update(*predict(small, covariance, model), measured, model)
    in_pixels, _ = update(*predict(small * scale, covariance, model), measured * scale, model)

    np.testing.assert_allclose(in_pixels, in_widths * scale)


@pytest.mark.parametrize("process_noise", [1e-7, 0.001, 0.5])
def test_the_noise_of_the_model_is_filterpys_to_the_last_bit(process_noise):
    model = motion_model(process_noise, 0.01)

    expected = Q_discrete_white_noise(2, dt=1.0, var=process_noise)
    assert model.process.tobytes() == np.asarray(expected).tobytes()
