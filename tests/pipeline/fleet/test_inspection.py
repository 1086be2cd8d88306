"""An agent imports no operator: one that fails on import affects only its own plan."""

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from pipeline.errors import RunError
from pipeline.fleet import inspection
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.inspection import Inspector, NotInspected
from pipeline.fleet.placement import ANY, Allowed, code_digest
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.graph.ports import fingerprints
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
import os, pathlib, subprocess, time
child = subprocess.Popen(["sleep", "600"], start_new_session=True)
here = pathlib.Path(__file__)
here.with_suffix(".new").write_text(f"{os.getpid()} {child.pid}")
here.with_suffix(".new").rename(here.with_suffix(".pid"))
time.sleep(600)
"""
ENDS_MEANWHILE = """
import os, sys, threading, time
from pathlib import Path
from pipeline.fleet.inspection import Inspector
from pipeline.graph.loader import load

graph, module, hangs = sys.argv[1:]
plan = load(Path(graph))
Path(module).write_text(hangs)
inspector = Inspector(Path(module).parent, lambda: False)
threading.Thread(target=inspector.prepare, args=(plan, {}, {}), daemon=True).start()
while not Path(module).with_suffix(".pid").exists():
    time.sleep(0.01)
os._exit(0)
"""


@pytest.fixture
def user_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a module that works, in a folder that Python imports from."""
    module = tmp_path / "user_part.py"
    module.write_text(WORKS)
    monkeypatch.syspath_prepend(tmp_path)
    paths = filter(None, (str(tmp_path), os.environ.get("PYTHONPATH")))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))  # of other processes
    yield module
    sys.modules.pop("user_part", None)


@pytest.fixture
def fleet(user_part: Path, tmp_path: Path) -> Iterator[Fleet]:
    """Run one host that allows `user_part:Part`."""
    own = host_of("box", (), tmp_path, operators={**ALLOWED, "user_part:Part": ANY})
    running = Running(own)
    with fleet_of("box") as found:
        yield found
    running.stop()


def pids(file: Path) -> list[int]:
    return [int(word) for word in file.read_text().split()]


def plan_of(folder: Path, operator: str, name: str) -> Plan:
    path = folder / f"{name}.yaml"
    path.write_text(GRAPH.format(name=name, operator=operator))
    return load(path)


def lay(fleet: Fleet, folder: Path, operator: str, name: str, module: str = WORKS) -> None:
    """Bring a graph up whose module is edited once the user has loaded it."""
    plan = plan_of(folder, operator, name)
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

    until(lambda: not any(map(psutil.pid_exists, pids(started))))
    (tmp_path / "user_part.py").write_text(WORKS)
    lay(fleet, tmp_path, "user_part:Part", "third")
    assert down("third", fleet.hosts) == []


def test_an_inspection_ends_when_its_agent_is_killed(user_part: Path, tmp_path: Path) -> None:
    plan_of(tmp_path, "user_part:Part", "graph")
    words = (str(tmp_path / "graph.yaml"), str(user_part), HANGS)

    subprocess.run([sys.executable, "-c", ENDS_MEANWHILE, *words], check=True, timeout=60)

    until(lambda: not any(map(psutil.pid_exists, pids(user_part.with_suffix(".pid")))))


def test_an_inspection_ends_when_its_agent_is_to_end(user_part: Path, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, "user_part:Part", "graph")
    user_part.write_text(HANGS)
    started = user_part.with_suffix(".pid")

    with pytest.raises(RunError, match="graph: not inspected, this agent is ending"):
        Inspector(tmp_path, started.exists).prepare(plan, {}, {})

    until(lambda: not any(map(psutil.pid_exists, pids(started))))


def test_what_was_prepared_is_begun_once_without_another_inspection(
    user_part: Path, tmp_path: Path
) -> None:
    plan = plan_of(tmp_path, "user_part:Part", "graph")
    known = fingerprints(plan)
    inspector = Inspector(tmp_path, lambda: False)
    inspector.prepare(plan, known, {})
    user_part.write_text("1 / 0\n")

    ports = inspector.begin(plan, known, {})

    assert ports["user_part:Part"].inputs.keys() == {"frame"}
    with pytest.raises(RunError, match="ZeroDivisionError"):
        inspector.begin(plan, known, {})


def test_another_plan_than_was_prepared_is_inspected(user_part: Path, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, "user_part:Part", "graph")
    known = fingerprints(plan)
    inspector = Inspector(tmp_path, lambda: False)
    inspector.prepare(plan, known, {})

    with pytest.raises(RunError, match=r"capture\.context: expected messages of schema none"):
        inspector.begin(plan, {}, {})


def test_code_of_another_file_than_the_one_whose_checksum_was_compared_is_refused(
    tmp_path: Path, user_part: Path
) -> None:
    for folder in ("package", "package/real"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "part.py").write_text(WORKS)
    redirects = "import os\n__path__.insert(0, os.path.join(__path__[0], 'real'))\n"
    (tmp_path / "package/__init__.py").write_text(redirects)
    path = "package.part:Part"
    plan = plan_of(tmp_path, "tests.samples:Pass", "graph")
    plan = replace(
        plan, nodes=tuple(replace(n, operator=path) if n.name == "work" else n for n in plan.nodes)
    )
    files = Allowed({path: code_digest(path)}, {}, tmp_path).files_of(plan)

    assert files == {"package.part": str(tmp_path / "package/part.py")}
    with pytest.raises(RunError, match=r"package\.part: expected the code in .*, got .*real"):
        Inspector(tmp_path, lambda: False).prepare(plan, {}, files)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, "tests.samples:Pass", "graph")

    with pytest.raises(NotInspected, match=r"no process can inspect it: .*missing"):
        Inspector(tmp_path / "missing", lambda: False).prepare(plan, {}, {})


def test_a_host_without_a_node_inspects_nothing(tmp_path: Path) -> None:
    plan = replace(plan_of(tmp_path, "tests.samples:Pass", "graph"), here="other")

    assert Inspector(tmp_path / "missing", lambda: False).begin(plan, {}, {}) == {}


def test_a_digest_is_computed_without_an_import(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    for folder in ("regular_outer", "bare_outer/inner"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "part.py").write_text("1 / 0\n")
    (tmp_path / "regular_outer/__init__.py").write_text("1 / 0\n")

    found = {code_digest(f"{name}.part:Part") for name in ("regular_outer", "bare_outer.inner")}

    assert len(found) == 1
    assert not {"regular_outer", "bare_outer"} & sys.modules.keys()
