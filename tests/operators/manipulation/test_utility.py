"""The utility of a window: nothing changes where it shows all, and most where it shows nothing."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the train extra")

from operators.manipulation.network import ActNetwork
from operators.manipulation.utility import NOTHING, Acquisition, changes, view
from tests.operators.manipulation.test_manipulation import SIZE, network

FIELD = 4 * SIZE[0], 4 * SIZE[1]


def test_a_window_on_what_matters_changes_the_action_least(tmp_path: Path) -> None:
    net = ActNetwork(network(tmp_path / "act.onnx", workplace="0 0 0.5 1"))
    picture = np.zeros((FIELD[1], FIELD[0], 3), np.uint8)
    picture[9:12, 9:12] = 255  # in the part that the network looks at
    # a scale at which the context has one pixel: nothing of it tells where things are
    how = Acquisition(context_scale=0.01, roi_scale=1.0)
    windows = [(0, 0, 32, 32), (32, 0, 64, 32), NOTHING]

    apart = changes(net, picture, np.zeros(2, np.float32), windows, how)

    assert apart[0] == pytest.approx(0, abs=1e-6)
    assert apart[1] == apart[2] > 0


def test_a_view_at_full_scale_is_the_picture(tmp_path: Path) -> None:
    net = ActNetwork(network(tmp_path / "act.onnx"))
    picture = np.random.default_rng(1).integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)

    seen = view(net, picture, NOTHING, Acquisition(context_scale=1.0))

    np.testing.assert_array_equal(seen, picture)
