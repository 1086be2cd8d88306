"""A lack of a resource is reported in one sentence, and nothing is left behind."""

import gc
import shlex
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from bench.leftovers import leftover_files
from pipeline import RunError
from pipeline.run.memory_folder import path_of
from pipeline.run.process_handle import NodeProcess, spawn
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import LOOP, plan_of
from tests.unruly_graphs import name_of, unruly_file

# descriptors; in between, only the call that fails is another one
MOST = (8, 12, 16, 20, 24)


@pytest.mark.parametrize(
    "most", [pytest.param(most, marks=pytest.mark.slow if most % 8 else []) for most in MOST]
)
def test_too_few_descriptors_are_one_sentence(tmp_path: Path, most: int) -> None:
    graph = unruly_file(tmp_path, text=LOOP)
    run = shlex.join([sys.executable, "-m", "pipeline.entry", "run", str(graph), "--frames", "5"])
    words = f"ulimit -n {most}; exec {run}"

    done = subprocess.run(
        ["bash", "-c", words], capture_output=True, text=True, timeout=90, check=False
    )

    said = done.stdout + done.stderr
    assert done.returncode in (1, 2), said
    assert "Traceback" not in said
    assert "fovea: " in done.stderr
    folder = base() / name_of(graph)
    assert not folder.exists() or leftover_files(folder) == []


@pytest.mark.parametrize("number", range(4))
def test_a_start_that_fails_half_way_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    plan, started = plan_of(tmp_path, LOOP), list[NodeProcess]()

    def refuse(*words: object, **more: object) -> NodeProcess:
        if len(started) == number:
            raise BlockingIOError("Resource temporarily unavailable")
        started.append(spawn(*words, **more))  # type: ignore[arg-type]
        return started[-1]

    monkeypatch.setattr("pipeline.run.process_manager.spawn", refuse)
    with Supervisor(plan) as supervisor:
        run_id = supervisor.manager.run_folder.run_id
        with pytest.raises(RunError, match="cannot be started: Resource temporarily unavailable"):
            supervisor.start()

    assert len(started) == number
    assert not any(psutil.pid_exists(process.pid) for process in started)
    assert leftover_files(base() / plan.name) == []
    assert not path_of(run_id).exists()


@pytest.mark.lengthy
def test_a_supervisor_that_cannot_come_up_holds_no_name_and_no_descriptor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, open_files = plan_of(tmp_path, LOOP), []

    def refuse(*_: object, **__: object) -> None:
        raise OSError(24, "Too many open files")

    for _ in range(3):
        for part in (
            "supervisor.Session",
            "process_manager.Exchange",
            "process_manager.Ledger.create",
        ):
            with monkeypatch.context() as patch:
                patch.setattr(f"pipeline.run.{part}", refuse)
                with pytest.raises(OSError, match="Too many open files"):
                    Supervisor(plan)
        gc.collect()
        open_files.append(psutil.Process().num_fds())

    assert len(set(open_files)) == 1
    with Supervisor(plan):
        pass
