"""Folders of running graphs have one owner each, and old logs are removed."""

import fcntl
import os
import secrets
import shutil
import threading
import time

import pytest

from pipeline import RunError
from pipeline.run.leftovers import KEEP_LOGS_S, cleanup
from pipeline.run.run_folder import CLAIM_S, RunFolder
from pipeline.run.rundir import base


def test_a_name_has_one_owner_at_a_time() -> None:
    name = f"test-{secrets.token_hex(3)}"
    owned = RunFolder.claim(name)
    owned.note({})

    with pytest.raises(RunError, match="already running"):
        RunFolder.claim(name)
    owned.release()

    RunFolder.claim(name).release()


def test_logs_of_last_week_stay_and_older_ones_go() -> None:
    fresh, stale = (base() / f"test-{secrets.token_hex(3)}" for _ in range(2))
    for folder, age_s in ((fresh, KEEP_LOGS_S - 60), (stale, KEEP_LOGS_S + 60)):
        RunFolder.claim(folder.name).release()
        (folder / "work.log").write_text("so it was")
        os.utime(folder / "lock", (time.time() - age_s,) * 2)

    cleanup()

    assert (fresh / "work.log").exists()
    assert not stale.exists()


def test_a_long_cleanup_keeps_no_graph_from_starting() -> None:
    folder = base() / f"test-{secrets.token_hex(3)}"
    RunFolder.claim(folder.name).release()
    lock = os.open(folder / "lock", os.O_RDWR)
    fcntl.flock(lock, fcntl.LOCK_EX)
    threading.Timer(2 * CLAIM_S, lambda: os.close(lock)).start()

    RunFolder.claim(folder.name).release()


def test_a_claim_that_breaks_leaves_the_name_free(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise OSError("the machine has no files left")

    name = f"test-{secrets.token_hex(3)}"
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.run.run_folder.cleanup", broken)
        with pytest.raises(OSError, match="no files left"):
            RunFolder.claim(name)

    RunFolder.claim(name).release()


@pytest.mark.parametrize("cleaned", [False, True])
def test_a_look_or_a_cleanup_keeps_no_graph_from_starting(*, cleaned: bool) -> None:
    folder = base() / f"test-{secrets.token_hex(3)}"
    RunFolder.claim(folder.name).release()
    lock = os.open(folder / "lock", os.O_RDWR)
    fcntl.flock(lock, fcntl.LOCK_EX if cleaned else fcntl.LOCK_SH)

    def let_go() -> None:
        if cleaned:
            shutil.rmtree(folder)
        os.close(lock)

    threading.Timer(0.1, let_go).start()
    owned = RunFolder.claim(folder.name)

    assert os.path.samestat(os.fstat(owned._lock), (folder / "lock").stat())
    owned.release()


def test_what_killed_nodes_leave_in_the_folder_is_removed_and_logs_are_not() -> None:
    owned = RunFolder.claim(f"test-{secrets.token_hex(3)}")
    for name in ("a.1.sock", "a.1.sock.lock", "a.1.recv", "a.live", "clocks", "a.log"):
        (owned.folder.path / name).touch()

    owned.release()

    assert {path.name for path in owned.folder.path.iterdir()} == {"a.log", "lock"}


def test_the_folder_is_private() -> None:
    assert base().stat().st_mode & 0o077 == 0
