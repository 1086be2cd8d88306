"""An agent imports no operator: one that fails on import affects only its own plan."""

import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from pipeline.errors import RunError
from pipeline.fleet import inspection
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.placement import ANY, code_digest
from pipeline.graph.loader import load
from tests.pipeline.fleet.agents import ALLOWED, Running, fleet_of, handled, host_of
from tests.sample_graphs import until

GRAPH = """
name: {name}
hosts: [box]
nodes:
  capture:
    operator: tests.samples:Ticker
    host: box
    settings: {{rate_hz: 30}}
  work:
    operator: {operator}
    host: box
    inputs: {{frame: capture.context}}
"""
WORKS = "from tests.samples import Pass as Part\n"
HANGS = """
import pathlib, subprocess, time
child = subprocess.Popen(["sleep", "600"], start_new_session=True)
pathlib.Path(__file__).with_suffix(".new").write_text(str(child.pid))
pathlib.Path(__file__).with_suffix(".new").rename(pathlib.Path(__file__).with_suffix(".pid"))
time.sleep(600)
"""


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    """One host that allows `user_part:Part`, which lies in `tmp_path`."""
    (tmp_path / "user_part.py").write_text(WORKS)
    monkeypatch.syspath_prepend(tmp_path)
    paths = filter(None, (str(tmp_path), os.environ.get("PYTHONPATH")))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))  # of the nodes
    own = host_of("box", (), tmp_path, operators={**ALLOWED, "user_part:Part": ANY})
    running = Running(own)
    with fleet_of("box") as found:
        yield found
    running.stop()
    sys.modules.pop("user_part", None)


def lay(fleet: Fleet, folder: Path, operator: str, name: str, module: str = WORKS) -> None:
    """Bring a graph up whose module is edited once the user has loaded it."""
    path = folder / f"{name}.yaml"
    path.write_text(GRAPH.format(name=name, operator=operator))
    plan = load(path)
    (folder / "user_part.py").write_text(module)
    up(fleet, plan)


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("import os\nos._exit(0)\n", "imported .*user_part:Part ended by exit status 0"),
        ("import os\nos.abort()\n", "imported .*user_part:Part ended by signal SIGABRT"),
        ("import sys\nsys.exit(3)\n", r"user_part\.py:2.*it exits: 3"),
        ("x = 1\ndef f(:\n", r"user_part\.py:2.*SyntaxError"),
    ],
)
def test_an_operator_that_breaks_when_it_is_imported_breaks_no_agent(
    module: str, said: str, fleet: Fleet, tmp_path: Path
) -> None:
    lay(fleet, tmp_path, "tests.samples:Pass", "first")

    with pytest.raises(RunError, match=said):
        lay(fleet, tmp_path, "user_part:Part", "second", module)

    before = handled(fleet, "box", "work", "first")
    until(lambda: handled(fleet, "box", "work", "first") > before)
    assert down("first", fleet.hosts) == []


def test_an_operator_that_hangs_when_it_is_imported_is_ended_with_what_it_started(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = tmp_path / "user_part.pid"
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patch:
        laid = pool.submit(lay, fleet, tmp_path, "user_part:Part", "second", HANGS)
        until(started.exists)
        patch.setattr(inspection, "INSPECT_S", 0.0)
        with pytest.raises(RunError, match=r"user_part:Part was not imported and checked within"):
            laid.result()

    until(lambda: not psutil.pid_exists(int(started.read_text())))
    (tmp_path / "user_part.py").write_text(WORKS)
    lay(fleet, tmp_path, "user_part:Part", "third")
    assert down("third", fleet.hosts) == []


def test_a_digest_is_had_without_an_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    for folder in ("regular_outer", "bare_outer/inner"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "part.py").write_text("1 / 0\n")
    (tmp_path / "regular_outer/__init__.py").write_text("1 / 0\n")

    found = {code_digest(f"{name}.part:Part") for name in ("regular_outer", "bare_outer.inner")}

    assert len(found) == 1
    assert not {"regular_outer", "bare_outer"} & sys.modules.keys()
