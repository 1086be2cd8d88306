"""The doctor reports what is wrong with a remedy, and reports nothing where nothing is wrong."""

import json
import os
import resource
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pytest
from packaging.requirements import Requirement

from pipeline.doctor.finding import Finding
from pipeline.doctor.installation import (
    bus,
    left_over,
    orphaned,
    python,
    requirements,
    versions,
)  # fmt: skip
from pipeline.doctor.machine import (
    available_cores,
    clock_source,
    examine_machine,
    governor,
    leases,
    open_files,
    ports,
    shared_memory,
)  # fmt: skip
from pipeline.doctor.needs import crowd, examine_graph, message_bytes, pool_bytes, pools
from pipeline.graph.overlay import Overlay
from pipeline.run.leftovers import cleanup, leftovers
from pipeline.run.memory_folder import MEMORY, path_of
from pipeline.run.rundir import memory_of, running
from pipeline.run.supervisor import Supervisor
from tests.pipeline.run.namespaces import with_small_mounts
from tests.sample_graphs import (
    CHAIN,
    KILLED,
    LOOP,
    ended,
    go,
    handled,
    plan_of,
    together,
    until,
    wait_for,
)


def verdicts(findings: list[Finding]) -> dict[str, str]:
    return {finding.what: finding.verdict for finding in findings}


def test_every_finding_has_a_remedy(tmp_path: Path) -> None:
    findings = [*examine_machine(), *examine_machine(memory=tmp_path / "none", system=tmp_path)]

    assert verdicts(findings)["shared memory"] == "wrong"
    assert all(finding.todo for finding in findings if finding.verdict != "ok")


def test_shared_memory_on_a_disk_is_reported(tmp_path: Path) -> None:
    assert shared_memory(MEMORY).verdict == "ok"
    assert "on a disk" in shared_memory(Path(__file__).parent).why
    assert shared_memory(tmp_path / "none").verdict == "wrong"
    assert leases(MEMORY).verdict == "ok"


@pytest.mark.parametrize(
    ("limits", "verdict"),
    [((1024, 4096), "ok"), ((300, 4096), "warning"), ((200, 200), "wrong"),
     ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), "ok")],
)  # fmt: skip
def test_open_files_must_suffice(limits: tuple[int, int], verdict: str) -> None:
    finding = open_files(limits, 250)

    assert finding.verdict == verdict
    if limits == (200, 200):
        assert finding.todo == "ulimit -n 200"


def test_a_control_group_may_allow_less_than_there_are_cores(tmp_path: Path) -> None:
    quota = tmp_path / "cpu.max"
    quota.write_text("50000 100000\n")

    assert available_cores(quota) == 0.5
    assert available_cores(tmp_path / "none") == len(os.sched_getaffinity(0))
    assert crowd(8, 0.5).verdict == "warning"
    assert crowd(8, 2).verdict == "ok"


def test_a_power_saving_governor_and_a_slow_clock_are_reported(tmp_path: Path) -> None:
    for place, word in (
        ("cpu/cpu0/cpufreq/scaling_governor", "powersave"),
        ("clocksource/clocksource0/current_clocksource", "hpet"),
    ):
        file = tmp_path / place
        file.parent.mkdir(parents=True)
        file.write_text(f"{word}\n")

    assert governor(tmp_path).verdict == "warning"
    assert "hpet" in clock_source(tmp_path).why
    assert clock_source(tmp_path).verdict == "warning"


def test_installed_packages_are_compared_with_the_requirements_of_the_project(
    tmp_path: Path,
) -> None:
    project = tmp_path / "pyproject.toml"
    project.write_text('[project]\ndependencies = ["numpy>=99", "psutil>=1", "fovea-nowhere"]\n')

    found = list(versions(requirements(project)))

    assert [(f.what, f.verdict) for f in found] == [
        ("package", "wrong"), ("package", "wrong"), ("packages", "ok"),
    ]  # fmt: skip
    assert found[0].why.startswith("numpy: expected >=99, got ")
    assert found[1].todo == "pip install 'fovea-nowhere'"


def test_the_requirements_of_this_project_are_installed() -> None:
    asked = requirements(Path("nowhere"))

    assert Requirement("numpy>=2.2,<3") in asked
    assert [f.verdict for f in versions(asked)] == ["ok"]
    assert (python((3, 10)).verdict, python((3, 11)).verdict) == ("wrong", "ok")
    assert bus().verdict == "ok"


def test_the_pools_of_a_graph_are_as_big_as_estimated(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(CHAIN, "ticker", "glance"))
    foreseen = pool_bytes(plan, message_bytes(plan))
    sizes = []

    def measure(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 5)
        folder = memory_of(running()[plan.name])
        sizes.append(sum(path.stat().st_size for path in folder.path.iterdir()))
        supervisor.finish()

    go(plan, 0, measure)

    assert sizes == [foreseen]
    assert pools(foreseen, 3 * foreseen).verdict == "ok"
    assert pools(foreseen, foreseen + 1).verdict == "warning"
    assert pools(foreseen, foreseen - 1).verdict == "wrong"


def test_a_graph_that_cannot_run_is_reported_without_running_it(tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: sick\n{LOOP}")

    broken = list(examine_graph(path, Overlay(changes=("ticker.fail_at=0",))))
    unknown = list(examine_graph(path, Overlay(changes=("ticker.fail=0",))))
    bug = list(examine_graph(path, Overlay(changes=("work.crash_at=0",))))

    assert (broken[-1].what, broken[-1].verdict) == ("trial", "wrong")
    assert broken[-1].why == "picture 0: torn"
    assert [f.verdict for f in unknown] == ["wrong"]
    assert "did you mean 'fail_at'" in unknown[0].why
    assert "ValueError: told to crash" in bug[-1].why


def test_files_that_no_run_makes_are_told_with_the_folder_that_stays_for_them() -> None:
    folder = path_of(secrets.token_hex(8))
    folder.mkdir(mode=0o700)
    for name in ("notes.txt", "ledger"):
        (folder / name).write_text("mine")
    try:
        assert str(folder) in leftovers()
        cleanup()
        assert str(folder) not in leftovers()
        (finding,) = [f for f in left_over() if str(folder) in f.why]
        assert finding.why.endswith("files that are none of it: notes.txt")
        assert finding.todo == "remove the folder, if these are not needed"
    finally:
        shutil.rmtree(folder)


def test_leftovers_of_a_killed_run_are_found_and_removed(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "steer"))
    command = [sys.executable, "-c", KILLED, str(tmp_path / "graph.yaml")]
    supervisor = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert supervisor.stdout is not None
    supervisor.stdout.readline()
    facts = running()[plan.name]
    frozen = psutil.Process(facts["pids"]["pair"])
    frozen.send_signal(signal.SIGSTOP)  # it cannot notice that its supervisor dies
    supervisor.kill()
    supervisor.wait()
    supervisor.stdout.close()

    told = "\n".join(f.why for f in left_over())

    assert plan.name in told
    # the start of another graph ends it, too, and holds its memory meanwhile
    until(lambda: frozen.pid in [p.pid for p in orphaned()] or ended(frozen.pid))
    cleanup()
    assert plan.name not in leftovers()
    until(lambda: not path_of(facts["run"]).exists())
    until(lambda: ended(frozen.pid))


def test_a_port_that_something_else_listens_on_is_named() -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        taken = listener.getsockname()[1]
        before = ports(taken, (taken, taken))
        listener.listen()
        held = ports(taken, (taken, taken))

    assert before.verdict == "ok"
    assert held.verdict == "warning"
    assert str(taken) in held.why
    assert "agent.yaml" in held.todo


def test_a_graph_whose_folder_is_elsewhere_is_no_leftover(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    plan, told = plan_of(tmp_path, together(LOOP, "work", "pair", "steer")), []

    def during(supervisor: Supervisor) -> None:
        facts = running()[plan.name]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("other")))
            assert plan.name not in running()
            words = "\n".join(f.why for f in left_over())
            told.extend([facts, words, [p.pid for p in orphaned()]])
        supervisor.finish()

    go(plan, 0, during)

    facts, words, orphans = told
    assert not set(facts["pids"].values()) & set(orphans)
    assert str(path_of(facts["run"])) not in words
    assert not [pid for pid in facts["pids"].values() if str(pid) in words.split()]


def test_where_shared_memory_is_too_small_the_doctor_reports_how_much_is_needed(
    tmp_path: Path,
) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: big\n{LOOP}")

    words = ("-m", "pipeline.cli", "doctor", str(path), "--json", "--set", "ticker.side_px=1000")
    done = with_small_mounts({MEMORY: "16m"}, *words)

    found = {f["what"]: f for f in json.loads(done.stdout)}
    assert done.returncode == 1
    assert found["shared memory"]["verdict"] == "warning"
    assert found["pools"]["verdict"] == "wrong"
    assert "MB for the frame pools, 17 MB free" in found["pools"]["why"]
    assert "remount,size=" in found["pools"]["todo"]
