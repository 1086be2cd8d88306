"""The regression over what encoder and detector say of candidates for a ball."""

import cv2
import numpy as np

from bench.second_look import FAINTEST, NAME, Looks, area, fitted, odds


def made_up(seed: int) -> np.ndarray:
    """Return candidates of which only the score in the ROI tells the true ones."""
    rng = np.random.default_rng(seed)
    true = rng.random(400) < 0.3
    rows = rng.uniform(0.1, 0.9, (400, 4))
    rows[:, 1] = np.clip(rng.normal(np.where(true, 0.7, 0.3), 0.1), 0, 1)
    rows[:, 3] = true
    return rows


def test_what_tells_true_candidates_has_the_gain() -> None:
    rows = made_up(1)

    weights = fitted(rows, (1, 2))

    assert weights[1] > 3 * abs(weights[2])
    assert area(odds(made_up(2), (1, 2), weights), made_up(2)[:, 3] > 0) > 0.95


def test_the_bias_is_the_share_of_true_candidates_where_nothing_tells_them() -> None:
    rows = made_up(3)
    rows[:, 1] = 0.5

    bias, _ = fitted(rows, (1,))

    share = rows[:, 3].mean()
    assert abs(bias - np.log(share / (1 - share))) < 0.05


def test_candidates_are_looked_at_as_the_broadcast_graph_does() -> None:
    picture = np.full((1080, 1920, 3), (60, 130, 50), np.uint8)
    cv2.circle(picture, (700, 600), 8, (250, 250, 250), -1, cv2.LINE_AA)
    ball = np.array([[692, 592, 708, 608]], np.float32)

    rows = Looks({NAME: FAINTEST}).rows(picture, ball)

    context, closer, encoder, true = max(rows, key=lambda row: row[0])
    assert true == 1
    assert min(context, closer) > 0.1
    assert 0 <= encoder <= 1
