"""Providers of networks: which are tried, and what happens where one does not load."""

import logging
from pathlib import Path

import numpy as np
import pytest

from operators.policy.network import SHIPPED
from operators.reader.reader import ReaderSettings
from operators.saliency import SaliencySettings
from operators.saliency.detector import EIGHT_BITS
from pipeline import SettingsError
from pipeline.graph.loader import load
from pipeline.inference import Network, available
from pipeline.providers import NAMES, PROVIDERS, NetworkSettings, missing, options_of, order
from pipeline.run.inline import InlineRunner

CPU_ALONE = ["CPUExecutionProvider"]
EVERYTHING = [full for full, _ in PROVIDERS.values()]


def test_the_fastest_is_tried_first_and_the_cpu_last():
    assert order("auto", EVERYTHING) == tuple(n for n in PROVIDERS if n != "openvino")
    assert order("auto", CPU_ALONE) == ("cpu",)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("auto", "cpu")])
def test_one_that_is_asked_for_is_tried_alone_before_the_cpu(name: str):
    assert order(name, EVERYTHING) == (name, "cpu")


@pytest.mark.parametrize("settings", [NetworkSettings, SaliencySettings])
def test_an_unknown_provider_is_refused_with_those_that_are_known(settings):
    with pytest.raises(SettingsError, match=r"provider: expected one of auto, .*cuda.*, got 'gpu'"):
        settings(provider="gpu")


@pytest.mark.parametrize("settings", [NetworkSettings, SaliencySettings, ReaderSettings])
@pytest.mark.parametrize("count", [0, 65, 1_000_000])  # a million take minutes and gigabytes
def test_threads_that_nobody_has_are_refused(settings, count: int):
    with pytest.raises(SettingsError, match=f"threads: expected 1 to 64, got {count}"):
        settings(threads=count)


def test_a_provider_that_is_not_installed_is_warned_of_and_the_cpu_computes(
    caplog: pytest.LogCaptureFixture,
):
    absent = next(name for name in PROVIDERS if name not in available())

    with caplog.at_level(logging.WARNING):
        network = Network(SHIPPED, provider=absent)

    assert network.provider == "cpu"
    (sentence,) = caplog.messages
    assert sentence.startswith(f"provider: {absent} is not in this installation")
    assert PROVIDERS[absent][1] in sentence
    assert network.headline() == f"policy on cpu, {absent} does not load"


def test_the_cpu_is_no_headline_where_nothing_else_was_asked_for():
    assert Network(SHIPPED, provider="cpu").headline() == ""


def test_auto_takes_what_is_there_without_a_warning(caplog: pytest.LogCaptureFixture):
    network = Network(SHIPPED, provider="auto")

    assert network.provider == order("auto", [PROVIDERS[n][0] for n in available()])[0]
    assert network.where() == {"provider of policy.onnx": network.provider}
    assert caplog.messages == []


def test_a_provider_that_does_not_start_is_warned_of_and_the_next_is_taken(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    import onnxruntime

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: EVERYTHING[1:2] + CPU_ALONE)
    with caplog.at_level(logging.WARNING):
        network = Network(SHIPPED)

    assert network.provider == "cpu"
    assert len(caplog.messages) == 1
    assert "provider: cuda" in caplog.messages[0]


def test_a_network_of_eight_bits_is_kept_from_a_provider_that_errs(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    import onnxruntime

    both = [PROVIDERS["openvino"][0], *CPU_ALONE]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: both)
    with caplog.at_level(logging.WARNING):
        network = Network(EIGHT_BITS, provider="openvino")

    assert network.provider == "cpu"
    (sentence,) = caplog.messages
    assert sentence.startswith("provider: detector_int8.onnx: openvino computes networks of eight")


def test_compiled_networks_are_kept_only_where_a_folder_is_given(tmp_path: Path):
    assert options_of("openvino", 2, "", tmp_path)["cache_dir"] == str(tmp_path)
    assert options_of("tensorrt", 1, "", tmp_path)["trt_engine_cache_path"] == str(tmp_path)
    assert "cache_dir" not in options_of("openvino", 2, "", None)
    assert options_of("cpu", 1, "", tmp_path) == {}


def test_the_device_is_the_one_that_is_named_or_the_first():
    assert options_of("openvino", 1, "NPU", None)["device_type"] == "NPU"
    assert options_of("cuda", 1, "1", None) == {"device_id": "1"}
    assert options_of("cuda", 1, "", None) == {"device_id": "0"}
    with pytest.raises(SettingsError, match="device: expected a name such as GPU or 0"):
        NetworkSettings(device="../0")


def test_no_sentence_is_said_of_what_is_installed():
    assert missing("cpu", CPU_ALONE) == missing("auto", []) == ""


@pytest.mark.skipif("openvino" not in available(), reason="needs onnxruntime-openvino")
@pytest.mark.parametrize(
    ("file", "tolerance"),
    [("saliency/detector.onnx", 0.02), ("tracker/template.onnx", 0.02)],
)
def test_openvino_computes_what_the_cpu_computes(
    file: str, tolerance: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("HOME", str(tmp_path))
    path = SHIPPED.parents[1] / file
    cpu, other = (Network(path, provider=name) for name in ("cpu", "openvino"))
    rng = np.random.default_rng(3)
    sides = {"images": (1, 3, 288, 480)}
    given = {
        name: rng.random(sides.get(name, shape), dtype=np.float32)
        for name, shape in cpu.inputs.items()
    }

    assert other.provider == "openvino"
    for name, expected in cpu(given).items():
        np.testing.assert_allclose(
            other(given)[name], expected, atol=tolerance * float(np.abs(expected).max())
        )
    assert list((tmp_path / ".cache" / "fovea" / "engines").iterdir())  # compiled once


def test_the_report_has_the_provider_of_every_node_with_a_network():
    with InlineRunner(load(Path("graphs/tracking.yaml"))) as runner:
        list(runner.run(1))
        stages = runner.report()["stages"]

    found = {stage["node"]: stage["provider"] for stage in stages if "provider" in stage}
    expected = Network(SHIPPED).provider
    assert found == dict.fromkeys(
        ("saliency", "closer", "roi_features", "policy", "tracker"), expected
    )
