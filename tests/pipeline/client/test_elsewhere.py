"""Commands work from any folder: they ask the running graph and import no operator of it."""

import json
import secrets
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.client.find import find
from pipeline.run.rundir import running
from tests.sample_graphs import until

FOVEA = (sys.executable, "-m", "pipeline.entry")
OPERATOR = '''
"""The brightness of frames, in a message class of its own."""
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import Frame, Input, Message, Operator


@dataclass(frozen=True, kw_only=True)
class BrightSettings:
    pass


@dataclass(frozen=True, kw_only=True, eq=False)
class Brightness(Message):
    mean: float
    rows: NDArray[np.float32]


class Bright(Operator[BrightSettings, Brightness]):
    frame = Input(Frame, keep="latest")

    def on_frame(self, frame: Frame) -> Brightness:
        rows = frame.pixels.mean(axis=(1, 2)).astype(np.float32)
        return Brightness(header=frame.header, mean=float(rows.mean()), rows=rows)


class Meter(Operator[BrightSettings, None]):
    brightness = Input(Brightness, keep="latest")

    def on_brightness(self, brightness: Brightness) -> None:
        return None
'''
GRAPH = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {rate_hz: 20, side_px: 60}
  bright:
    operator: MODULE:Bright
    inputs: {frame: ticker.context}
"""
COUNT = """\
nodes:
  count:
    operator: tests.samples:Count
    inputs: {frame: bright}
"""
METER = """\
nodes:
  meter:
    operator: MODULE:Meter
    inputs: {brightness: bright}
"""


def fovea(*words: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*FOVEA, *words], cwd=cwd, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("elsewhere")


@pytest.fixture(scope="module")
def name(tmp_path_factory: pytest.TempPathFactory, elsewhere: Path) -> Iterator[str]:
    """Run a graph whose operator is in its own folder only; yield the graph's name."""
    home, module = tmp_path_factory.mktemp("home"), f"mine_{secrets.token_hex(3)}"
    name = f"else-{secrets.token_hex(3)}"
    (home / f"{module}.py").write_text(OPERATOR)
    (home / "graph.yaml").write_text(f"name: {name}\n" + GRAPH.replace("MODULE", module))
    (elsewhere / "meter.yaml").write_text(METER.replace("MODULE", module))
    (elsewhere / "count.yaml").write_text(COUNT)
    begun = fovea("run", "graph.yaml", "--detach", cwd=home)
    assert begun.returncode == 0, begun.stderr
    yield name
    nodes = find(name).nodes() if name in running() else ()
    if nodes:
        find(name).stop()
    assert nodes == ("ticker", "bright")


@pytest.mark.lengthy
def test_commands_work_from_a_folder_without_the_operators(elsewhere: Path, name: str) -> None:
    rate = fovea("hz", name, "bright", "--duration-s", "5", "--json", cwd=elsewhere)
    heard = fovea("echo", name, "bright", "--count", "2", "--json", cwd=elsewhere)
    added = fovea("add", name, "meter.yaml", "--json", cwd=elsewhere)
    rewired = fovea("rewire", name, "bright.frame=ticker.roi", "--json", cwd=elsewhere)
    until(lambda: (health := find(name).health()["meter"]) and health.handled > 3)
    removed = fovea("remove", name, "meter", "--json", cwd=elsewhere)

    assert json.loads(rate.stdout)["messages"] >= 2, rate.stderr
    assert json.loads(rate.stdout)["rate_hz"] > 0
    first = json.loads(heard.stdout.splitlines()[0])
    assert isinstance(first["mean"], float)
    assert first["rows"]["dtype"] == "float32"
    assert json.loads(added.stdout)["added"] == ["meter"], added.stderr
    assert json.loads(rewired.stdout)["connected"] == ["ticker.roi -> bright.frame"]
    assert json.loads(removed.stdout)["removed"] == ["meter"], removed.stderr


def test_a_message_that_does_not_fit_is_refused_by_its_name(elsewhere: Path, name: str) -> None:
    refused = fovea("add", name, "count.yaml", cwd=elsewhere)

    assert refused.returncode == 2
    assert refused.stderr.strip() == (
        "fovea: count.yaml:4: count.inputs.frame: expected Frame, got Brightness from bright"
    )
