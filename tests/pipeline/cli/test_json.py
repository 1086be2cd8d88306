"""Every command with `--json` prints JSON whose keys do not change."""

import secrets
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from pipeline.cli import commands
from pipeline.client.find import find
from pipeline.run.rundir import running
from tests.json_answers import ANSWERS, answer, check

FOVEA = (sys.executable, "-m", "pipeline.entry")
GRAPH = """\
nodes:
  capture:
    operator: tests.samples:Ticker
    settings: {rate_hz: 20, side_px: 60}
  work:
    operator: tests.samples:Pass
    inputs: {frame: capture.context}
  count:
    operator: tests.samples:Count
    inputs: {frame: work}
  spare:
    operator: tests.samples:Count
    inputs: {frame: capture.roi}
"""
TALLY = """\
nodes:
  tally:
    operator: tests.samples:Count
    inputs: {frame: capture.roi}
"""
STILL = {
    "version": {"version", "commit"},
    "check tracking": {"file", "name", "clock", "nodes", "processes", "edges", "advice", "plan"},
    "check tracking --no-import": {"file", "survey"},
    "sensors": {"kinds"},
}
# attach, run --detach, up, down, rewire, doctor: in the tests of their own
ELSEWHERE = {"tune", "attach", "run", "up", "down", "rewire", "doctor"}


@pytest.fixture
def places(tmp_path: Path) -> Iterator[dict[str, str]]:
    name = f"json-{secrets.token_hex(3)}"
    (tmp_path / "graph.yaml").write_text(f"name: {name}\n{GRAPH}")
    (tmp_path / "tally.yaml").write_text(TALLY)
    command = [*FOVEA, "run", str(tmp_path / "graph.yaml"), "--detach"]
    assert subprocess.run(command, check=False, timeout=120).returncode == 0
    yield {"GRAPH": name, "FILE": str(tmp_path / "tally.yaml")}
    if name in running():
        find(name).stop()


def test_a_running_graph_answers_every_question_and_order_with_its_keys(
    places: dict[str, str],
) -> None:
    check(ANSWERS, **places)


@pytest.mark.parametrize("words", STILL)
def test_what_needs_no_running_graph_answers_with_its_keys(words: str) -> None:
    status, (found,) = answer(words)

    assert status == 0
    assert found.keys() == STILL[words]


def test_no_command_with_json_is_left_out_of_these_tests() -> None:
    with click.Context(commands) as context:
        names = commands.list_commands(context)
        having = {
            name
            for name in names
            for option in getattr(commands.get_command(context, name), "loaded", lambda: None)()
            .get_params(context)
            if "--json" in option.opts
        }  # fmt: skip

    tried = {words.split()[0] for words in (*ANSWERS, *STILL)}
    assert having == tried | ELSEWHERE
