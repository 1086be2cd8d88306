"""Networks run without telemetry or a trace in the home; inputs bound to a device's memory."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

from pipeline.errors import WeightsError
from pipeline.inference import Bound, Network
from pipeline.providers import memory_of

ROOT = Path(__file__).resolve().parents[2]
DETECTOR = ROOT / "operators/saliency/detector.onnx"
LOAD = "from pipeline.inference import Network; Network('operators/policy/policy.onnx')"


def test_a_network_is_loaded_without_a_trace_in_the_users_home(tmp_path: Path) -> None:
    env = {**os.environ, "HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    env.pop("ORT_DISABLE_TELEMETRY", None)

    subprocess.run([sys.executable, "-c", LOAD], env=env, cwd=ROOT, check=True)

    assert list(tmp_path.rglob("*")) == []


def session() -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(str(DETECTOR), providers=["CPUExecutionProvider"])


def test_inputs_that_are_bound_give_the_same_bits_for_every_size() -> None:
    rng = np.random.default_rng(0)
    bound, network = Bound(session(), "cpu", 0), Network(DETECTOR, provider="cpu")
    shapes = ((96, 160), (96, 160), (64, 128), (96, 160))
    pictures = [rng.random((1, 3, *shape), dtype=np.float32) for shape in shapes]
    pictures.append(pictures[0].transpose(0, 1, 3, 2))  # not in one piece of memory

    found = [bound({"images": picture}) for picture in pictures]

    for picture, outputs in zip(pictures, found, strict=True):  # also those of earlier calls
        expected = list(network({"images": picture}).values())
        assert [a.tobytes() for a in outputs] == [a.tobytes() for a in expected]
        assert [a.shape for a in outputs] == [a.shape for a in expected]


def test_a_bound_input_is_written_where_the_last_one_was() -> None:
    bound, picture = Bound(session(), "cpu", 0), np.zeros((1, 3, 64, 128), np.float32)
    first = bound({"images": picture})[0]

    picture += 1  # the caller writes its next picture into the same memory
    second = bound({"images": picture})[0]

    assert (first != second).any()


def test_what_a_bound_network_cannot_compute_leaves_it_usable() -> None:
    bound, picture = Bound(session(), "cpu", 0), np.zeros((1, 3, 64, 128), np.float32)
    expected = bound({"images": picture})[0]

    with pytest.raises(Exception, match="images"):
        bound({"images": np.zeros((1, 4, 64, 128), np.float32)})

    assert (bound({"images": picture})[0] == expected).all()


PICTURE = np.zeros((1, 3, 64, 128), np.float32)


@pytest.mark.parametrize("is_bound", [True, False])
@pytest.mark.parametrize("calls_before", [0, 1])
@pytest.mark.parametrize(
    ("feeds", "reason"),
    [
        ({}, "images"),
        ({"other": PICTURE}, "images"),
        ({"images": PICTURE, "other": PICTURE}, "other"),
    ],
)
def test_a_missing_or_unknown_input_is_refused_at_every_call(
    feeds: dict[str, NDArray[np.float32]], reason: str, calls_before: int, is_bound: bool
) -> None:
    network = Network(DETECTOR, provider="cpu")
    if is_bound:  # as with a provider that has its own memory
        network._run = Bound(network._session, "cpu", 0)
    for _ in range(calls_before):
        network({"images": PICTURE})

    for _ in range(2):
        with pytest.raises(WeightsError, match=f"cannot run on .*: .*{reason}"):
            network(feeds)

    assert network({"images": PICTURE})


@pytest.mark.parametrize(
    ("provider", "device", "memory"),
    [("cuda", "", ("cuda", 0)), ("tensorrt", "1", ("cuda", 1)), ("cpu", "", None),
     ("openvino", "GPU", None), ("qnn", "", None), ("coreml", "", None)],
)  # fmt: skip
def test_only_providers_with_memory_of_their_own_have_inputs_bound(
    provider: str, device: str, memory: tuple[str, int] | None
) -> None:
    assert memory_of(provider, device) == memory
