"""Leftovers of killed runs are found and removed, and nothing that fovea did not make."""

import fcntl
import json
import os
import secrets
import stat
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import RunError
from pipeline.private_folder import PrivateFolder
from pipeline.run.leftovers import KEEP_LOGS_S, clean_memory, cleanup, leftovers
from pipeline.run.logs import log_lines
from pipeline.run.memory_folder import MemoryFolder, abandoned, path_of
from pipeline.run.run_folder import RunFolder
from pipeline.run.rundir import base, folder_of, noted, running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import CHAIN, plan_of

NO_RUN_NAMES = ["", ".", "..", "../x", "/etc", "a/b", "a@b@c", "@", "a@", "@b", "a b", "x" * 33]


@pytest.fixture
def name() -> str:
    return f"test-{secrets.token_hex(3)}"


@pytest.fixture
def other_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / f"fovea-{os.geteuid()}"


def killed(memory: Path) -> Path:
    """Make the memory folder of a killed run; not in /dev/shm, where any start removes it."""
    folder = MemoryFolder.claim(memory)
    folder.write("ledger", b"accounts")
    folder.write("eye.out.0123abcd", b"pictures")
    fcntl.flock(folder.handle, fcntl.LOCK_UN)
    return folder.path


@pytest.mark.parametrize("text", NO_RUN_NAMES)
def test_what_is_no_name_never_becomes_a_path(text: str) -> None:
    for act in (folder_of, RunFolder.claim):
        with pytest.raises(RunError, match="expected the name of a graph"):
            act(text)
    with pytest.raises(RunError, match="expected the name of a graph"):
        list(log_lines(text, "work", 5, follow=False))


@pytest.mark.parametrize("node", [*NO_RUN_NAMES, "work@here"])
def test_what_is_no_name_of_a_node_has_no_log_in_a_folder_that_is_there(
    node: str, name: str
) -> None:
    owned = RunFolder.claim(name)
    (owned.folder.path / f"{node if '/' not in node else 'x'}.log").write_text("not of a node")

    with pytest.raises(RunError, match="no log of a node"):
        list(log_lines(name, node, 5, follow=False))
    owned.release()


@pytest.mark.parametrize("text", [*NO_RUN_NAMES, "0" * 15, "0" * 17, "0" * 15 + "A", "*" * 16])
def test_what_is_no_id_of_a_run_never_becomes_a_path(text: str) -> None:
    with pytest.raises(RunError, match="expected 16 hex digits"):
        path_of(text)


def test_files_of_the_user_beside_ours_stay_whatever_is_cleaned(name: str) -> None:
    foreign = ["notes.txt", "run.json.bak", "picture.png", "a.b.sock.txt", ".hidden", "work.rrd"]
    owned = RunFolder.claim(name)
    for file in foreign:
        (owned.folder.path / file).write_text("mine")
    (owned.folder.path / "folder.sock").mkdir()
    owned.note(FACTS | {"run": owned.run_id})

    owned.release()
    RunFolder.claim(name).release()
    os.utime(owned.folder.path / "lock", (time.time() - KEEP_LOGS_S - 60,) * 2)
    cleanup()

    assert {p.name for p in owned.folder.path.iterdir()} == {*foreign, "folder.sock"}
    assert (owned.folder.path / "notes.txt").read_text() == "mine"


def test_memory_without_a_run_file_is_found_and_removed(tmp_path: Path) -> None:
    path = killed(tmp_path)
    assert [folder.path for folder in abandoned(fcntl.LOCK_SH, tmp_path)] == [path]

    clean_memory(tmp_path)

    assert list(tmp_path.iterdir()) == []


def test_the_memory_of_a_run_that_lives_stays(name: str) -> None:
    owned = RunFolder.claim(name)
    owned.memory.write("ledger", b"accounts")

    cleanup()

    assert str(owned.memory.path) not in leftovers()
    assert owned.memory.read("ledger") == b"accounts"
    owned.release()
    assert not owned.memory.path.exists()


def test_a_run_that_lives_keeps_its_memory_whatever_another_folder_says(name: str) -> None:
    alive, stale = RunFolder.claim(name), RunFolder.claim(f"{name}-old")
    stale.release()
    alive.memory.write("ledger", b"accounts")
    stale.folder.write("run.json", json.dumps(FACTS | {"run": alive.run_id}).encode())

    cleanup()

    assert not stale.folder.has("run.json")
    assert alive.memory.read("ledger") == b"accounts"
    alive.release()


def test_what_else_lies_in_abandoned_memory_stays_with_its_folder(tmp_path: Path) -> None:
    path = killed(tmp_path)
    (path / "thesis.tex").write_text("mine")

    clean_memory(tmp_path)

    assert [p.name for p in path.iterdir()] == ["thesis.tex"]
    (path / "thesis.tex").unlink()
    clean_memory(tmp_path)
    assert not path.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give folders away")
def test_a_memory_folder_of_another_user_is_not_removed(tmp_path: Path) -> None:
    path = path_of(secrets.token_hex(8), tmp_path)
    path.mkdir(mode=0o700)
    os.chown(path, 65534, 65534)

    clean_memory(tmp_path)

    assert path.exists()


def test_memory_is_private_and_its_name_is_another_one_each_time() -> None:
    folders = [MemoryFolder.claim() for _ in range(3)]

    assert len({folder.run_id for folder in folders}) == 3
    for folder in folders:
        assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700
        folder.empty()


def test_a_folder_that_a_cleanup_took_for_abandoned_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, tries = MemoryFolder.lock, []

    def lock(folder: MemoryFolder, kind: int) -> bool:
        tries.append(folder.path)
        if len(tries) == 1:
            folder.path.rmdir()  # what a cleanup does between the making and the lock
        return real(folder, kind)

    monkeypatch.setattr(MemoryFolder, "lock", lock)
    folder = MemoryFolder.claim(tmp_path)

    assert folder.path == tries[1] != tries[0]
    assert folder.exists


def test_files_and_links_where_run_folders_are_expected_are_left_alone(other_base: Path) -> None:
    base()
    (other_base / "file").touch()
    (other_base / "link").symlink_to("/etc")
    os.mkfifo(other_base / "pipe")
    (other_base / "open").mkdir()
    (other_base / "open").chmod(0o755)  # whatever the umask

    assert running() == {}
    assert not {"file", "link", "pipe", "open"} & set(leftovers())
    cleanup()
    for taken in ("file", "pipe", "link", "open"):
        with pytest.raises(RunError, match=taken):
            RunFolder.claim(taken)
    assert sorted(p.name for p in other_base.iterdir()) == ["file", "link", "open", "pipe"]


def test_a_file_in_the_place_of_the_folder_of_all_graphs_is_refused_in_one_sentence(
    other_base: Path,
) -> None:
    other_base.write_text("mine")

    with pytest.raises(RunError, match="cannot be opened as a folder"):
        base()
    assert other_base.read_text() == "mine"


def test_a_folder_too_long_for_sockets_is_refused_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plan, deep = plan_of(tmp_path, CHAIN), tmp_path / ("x" * 100)
    deep.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(deep))

    with pytest.raises(RunError, match="set TMPDIR to a shorter folder"):
        Supervisor(plan)
    assert list((deep / f"fovea-{os.geteuid()}").iterdir()) == []


def test_a_temporary_folder_in_which_others_may_rename_is_refused(
    other_base: Path, tmp_path: Path
) -> None:
    tmp_path.chmod(0o777)

    with pytest.raises(RunError, match="expected a sticky folder"):
        base()
    tmp_path.chmod(0o1777)
    assert base() == other_base


FACTS = {
    "graph": "a", "run": "0" * 16, "pid": 1, "clock": "realtime", "plan": {}, "revision": 0,
    "nodes": [{"name": "eye", "index": 0, "process": "eye", "operator": "m:C"}],
    "edges": [{"from": "eye", "to": "work.frame", "index": 0}], "pids": {"eye": 1},
    "restarts": {"eye": 2}, "crashes": {"eye": 3}, "gone": ["eye"],
}  # fmt: skip


def facts_of(tmp_path: Path, data: bytes) -> object:
    folder = PrivateFolder(tmp_path)
    folder.write("run.json", data)
    return noted(folder)


def test_what_a_supervisor_notes_is_read_as_it_is(tmp_path: Path) -> None:
    assert facts_of(tmp_path, json.dumps(FACTS).encode()) == FACTS


@pytest.mark.parametrize(
    "change",
    [
        {"graph": "../.."}, {"run": "x"}, {"run": "../" + "0" * 13}, {"pid": "1"},
        {"pids": {"a/b": 1}}, {"restarts": {"a/b": 1}}, {"crashes": {"eye": "1"}},
        {"gone": ["a/b"]}, {"gone": "eye"},
        {"nodes": [{"name": "../x", "index": 0, "process": "eye", "operator": "m:C"}]},
        {"nodes": [{"name": "eye", "index": 0, "process": "/tmp/x", "operator": "m:C"}]},
        {"nodes": None}, {"edges": [1]}, {"plan": []},
    ],
)  # fmt: skip
def test_facts_that_no_supervisor_wrote_are_ignored(
    tmp_path: Path, change: dict[str, object]
) -> None:
    assert facts_of(tmp_path, json.dumps(FACTS | change).encode()) == {}


@given(st.one_of(st.binary(max_size=200), st.just(b"[" * 100_000), st.just(b'{"a":' * 50_000)))
def test_no_bytes_in_the_place_of_facts_break_the_reader(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    assert facts_of(tmp_path_factory.mktemp("run"), data) == {}
