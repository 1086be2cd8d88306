"""Networks of half precision, and feeds that a network cannot compute with."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import WeightsError
from pipeline.inference import HALF, Network
from tests.operators.networks import constant_network

ANSWER = np.arange(12, dtype=np.float32).reshape(1, 6, 2) / 8


def test_half_precision_is_converted_on_both_sides(tmp_path: Path) -> None:
    network = Network(constant_network(tmp_path / "n.onnx", ANSWER, size_px=(32, 32), half=True))

    answer = network({"images": np.ones((1, 3, 32, 32), np.float32)})["output"]

    assert network.input_types == {"images": HALF}
    assert answer.dtype == np.float32
    assert answer.tolist() == ANSWER.tolist()


def test_an_array_of_another_size_is_one_sentence_with_the_file(tmp_path: Path) -> None:
    network = Network(constant_network(tmp_path / "n.onnx", ANSWER, size_px=(32, 32)))

    with pytest.raises(WeightsError) as caught:
        network({"images": np.ones((1, 3, 32, 48), np.float32)})

    assert f"{tmp_path}/n.onnx: cannot run on images (1, 3, 32, 48): " in str(caught.value)
    assert "\n" not in str(caught.value)
