"""Writing a file whole changes nothing else: files and links of the user beside it stay."""

import json
import os
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bench.peers import ruler
from bench.tracking import store as units
from operators.training import arrays
from pipeline.cli.files import write_report
from pipeline.errors import RunError
from pipeline.fleet import secure
from pipeline.fleet.agent_file import GraphStore
from pipeline.fleet.placement import Allowed
from pipeline.whole_file import whole_file, write_whole
from tests.full_disk import full_disk

Writer = Callable[[Path], Path]  # writes into a folder, returns what it wrote


def by_report(folder: Path) -> Path:
    assert write_report(folder / "out.json", {"a": 1}, "--report") == ""
    return folder / "out.json"


def by_agent(folder: Path) -> Path:
    GraphStore(folder).count("out")
    return folder / "out.starts"


def by_weights(folder: Path) -> Path:
    digest = "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d"  # of one zero byte
    Allowed(code={}, weights={digest: None}, store=folder).keep(b"\0")
    return folder / digest


def by_authority(folder: Path) -> Path:
    secure.create(folder)
    return folder / "ca.key"


def by_authority_public(folder: Path) -> Path:
    secure.create(folder)
    return folder / "ca.pem"


def by_arrays(folder: Path) -> Path:
    arrays.write(folder / "out.npz", {"a": np.arange(3)}, {})
    return folder / "out.npz"


def by_training(folder: Path) -> Path:
    pytest.importorskip("torch", reason="needs the train extra")
    from operators.training.checkpoint import Progress

    Progress(folder, {}, {}).save()
    return folder / "checkpoint.pt"


def by_peers(folder: Path) -> Path:
    ruler._put(folder / "out.json", {"a": 1})
    return folder / "out.json"


def by_units(folder: Path) -> Path:
    units._write(folder / "out.json", [])
    return folder / "out.json"


WRITERS = (
    by_report, by_agent, by_weights, by_authority, by_authority_public, by_arrays, by_training,
    by_peers, by_units,
)  # fmt: skip


def beside(path: Path) -> Iterator[Path]:
    """Yield names that are easily guessed for a temporary file."""
    for suffix in (".part", ".tmp", ".new", "~", ".part.npz"):
        yield path.with_name(f"{path.name}{suffix}")
        yield path.with_name(f"{path.stem}{suffix}")


@pytest.mark.parametrize("write", WRITERS)
def test_files_beside_it_stay_as_they_are(write: Writer, tmp_path: Path) -> None:
    (tmp_path / "aim").mkdir()
    (tmp_path / "trial").mkdir()
    written = write(tmp_path / "trial").name
    for path in beside(tmp_path / "aim" / written):
        path.write_text("of the user")

    path = write(tmp_path / "aim")

    assert path.stat().st_size > 0
    assert {p.read_text() for p in beside(path)} == {"of the user"}
    assert {p.name for p in path.parent.iterdir() if p.name.startswith(".")} == set()


@pytest.mark.parametrize("write", WRITERS)
def test_links_beside_it_are_not_followed(write: Writer, tmp_path: Path) -> None:
    (tmp_path / "trial").mkdir()
    (tmp_path / "aim").mkdir()
    thesis = tmp_path / "thesis.tex"
    thesis.write_text("three years")
    written = write(tmp_path / "trial").name
    for path in beside(tmp_path / "aim" / written):
        path.unlink(missing_ok=True)
        path.symlink_to(thesis)

    write(tmp_path / "aim")

    assert thesis.read_text() == "three years"
    assert all(p.is_symlink() for p in beside(tmp_path / "aim" / written))


def test_a_failed_write_leaves_the_older_file_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def fail_half_way() -> None:
        with whole_file(path) as file:
            file.write(b"half of it")
            file.flush()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()

    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_readers_see_all_of_the_old_or_all_of_the_new(tmp_path: Path) -> None:
    path, done = tmp_path / "file.json", threading.Event()
    write_whole(path, json.dumps([0] * 50_000))
    seen = set()

    def write() -> None:
        for value in range(1, 30):
            write_whole(path, json.dumps([value] * 50_000))
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not done.is_set():
        values = json.loads(path.read_text())
        seen.add((len(values), len(set(values))))
    writer.join()

    assert seen == {(50_000, 1)}


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_its_mode_follows_the_umask(mask: int, mode: int, tmp_path: Path) -> None:
    with umask(mask):
        write_whole(tmp_path / "file", "x")
        write_whole(tmp_path / "key", "x", secret=True)

    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode
    assert stat.S_IMODE((tmp_path / "key").stat().st_mode) == 0o600


def test_a_link_in_its_place_is_replaced_and_the_target_stays(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("three years")
    (tmp_path / "file").symlink_to(tmp_path / "thesis.tex")

    write_whole(tmp_path / "file", "x")

    assert (tmp_path / "thesis.tex").read_text() == "three years"
    assert (tmp_path / "file").read_text() == "x"
    assert not (tmp_path / "file").is_symlink()


def test_an_agent_that_cannot_write_raises(tmp_path: Path) -> None:
    store = GraphStore(tmp_path / "nowhere")

    with pytest.raises(RunError, match=r"g\.starts: cannot be written: No such file"):
        store.count("g")


@pytest.mark.parametrize("kind", ["pipe", "link to a pipe", "link to what a process has open"])
def test_a_device_or_a_pipe_is_refused_and_stays(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "out"
    if kind == "link to what a process has open":
        path.symlink_to("/proc/self/fd/1")
    elif kind == "link to a pipe":
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to(tmp_path / "pipe")
    else:
        os.mkfifo(path)
    before = path.lstat()

    with pytest.raises(OSError, match="expected a regular file, got a device or a pipe"):
        write_whole(path, "data")

    assert (path.lstat().st_ino, path.lstat().st_mode) == (before.st_ino, before.st_mode)


def test_a_full_disk_is_told_with_the_file_and_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("before")

    with full_disk(1000), pytest.raises(OSError, match=r"report\.json") as refused:
        write_whole(path, bytes(2000))

    assert refused.value.filename == str(path)
    assert path.read_text() == "before"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.json"]


def test_a_name_that_is_taken_is_not_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("secrets.token_hex", lambda _: "chosen")
    theirs = tmp_path / ".fovea-chosen.part"
    theirs.write_text("somebody's")

    with pytest.raises(FileExistsError):
        write_whole(tmp_path / "out", "data")

    assert theirs.read_text() == "somebody's"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("durable", [True, False])
def test_what_has_to_survive_a_power_failure_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    path, on_disk, sync = tmp_path / "out", [], os.fsync

    def fsync(handle: int) -> None:
        sync(handle)
        on_disk.append((os.fstat(handle).st_size, path.exists()))

    monkeypatch.setattr("os.fsync", fsync)

    write_whole(path, "data", durable=durable)

    assert on_disk == ([(4, False)] if durable else [])
    assert path.read_text() == "data"
