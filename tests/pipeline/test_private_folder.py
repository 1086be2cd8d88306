"""A private folder never reads, follows, trusts or removes a file of another user."""

import os
import stat
from pathlib import Path

import pytest

from pipeline import RunError
from pipeline.private_folder import PrivateFolder

STRANGER = 65534
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture
def folder(tmp_path: Path) -> PrivateFolder:
    return PrivateFolder.make(tmp_path / "private")


def test_a_folder_is_made_for_this_user_alone_and_only_once(tmp_path: Path) -> None:
    folder = PrivateFolder.make(tmp_path / "private")

    assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700
    with pytest.raises(FileExistsError):
        PrivateFolder.make(folder.path)


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o722])
def test_a_folder_that_others_can_enter_is_refused(tmp_path: Path, mode: int) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(mode)

    with pytest.raises(RunError, match=f"with mode 700, got one of user .* with mode {mode:o}"):
        PrivateFolder(tmp_path / "open")


@needs_root
def test_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir(mode=0o700)
    os.chown(tmp_path / "theirs", STRANGER, STRANGER)

    with pytest.raises(RunError, match=f"got one of user {STRANGER}"):
        PrivateFolder(tmp_path / "theirs")


def test_a_link_a_file_and_a_missing_path_are_refused_as_folders(
    tmp_path: Path, folder: PrivateFolder
) -> None:
    (tmp_path / "link").symlink_to(folder.path)
    (tmp_path / "file").touch()

    for name in ("link", "file", "nothing"):
        with pytest.raises(RunError, match="cannot be opened as a folder"):
            PrivateFolder(tmp_path / name)


def test_a_written_file_is_read_back_and_only_its_owner_may_read_it(folder: PrivateFolder) -> None:
    folder.write("facts", b"one")
    folder.write("facts", b"two")

    assert folder.read("facts") == b"two"
    assert folder.names() == ["facts"]
    assert stat.S_IMODE((folder.path / "facts").stat().st_mode) == 0o600
    with pytest.raises(OSError, match="longer than 2 bytes"):
        folder.read("facts", 2)


def test_a_write_that_fails_leaves_nothing_behind(folder: PrivateFolder) -> None:
    (folder.path / "facts").mkdir()

    with pytest.raises(OSError, match="facts"):
        folder.write("facts", b"one")

    assert folder.names() == ["facts"]


def test_a_file_is_created_only_where_there_is_none(folder: PrivateFolder, tmp_path: Path) -> None:
    (tmp_path / "aim").write_text("untouched")
    (folder.path / "link").symlink_to(tmp_path / "aim")
    (folder.path / "dangling").symlink_to(tmp_path / "nowhere")

    for name in ("link", "dangling"):
        with pytest.raises(FileExistsError):
            folder.create(name)
    assert (tmp_path / "aim").read_text() == "untouched"
    assert not (tmp_path / "nowhere").exists()


def test_links_pipes_and_folders_are_not_opened(folder: PrivateFolder, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    (folder.path / "link").symlink_to(tmp_path / "secret")
    (folder.path / "folder").mkdir()
    os.mkfifo(folder.path / "pipe")

    for name in ("link", "folder", "pipe"):
        assert not folder.has(name)
        with pytest.raises(OSError, match=r".+"):
            folder.open(name)


@needs_root
def test_a_file_of_another_user_is_neither_opened_nor_removed(folder: PrivateFolder) -> None:
    folder.write("theirs", b"trap")
    os.chown(folder.path / "theirs", STRANGER, STRANGER)

    assert not folder.has("theirs")
    with pytest.raises(PermissionError, match="not a file of this user"):
        folder.open("theirs")
    assert not folder.remove("theirs")
    assert folder.names() == ["theirs"]


def test_only_files_and_sockets_are_removed(folder: PrivateFolder, tmp_path: Path) -> None:
    (tmp_path / "aim").write_text("untouched")
    (folder.path / "link").symlink_to(tmp_path / "aim")
    (folder.path / "folder").mkdir()
    folder.write("file", b"")

    assert [n for n in ("link", "folder", "file", "nothing") if folder.remove(n)] == ["file"]
    assert (tmp_path / "aim").read_text() == "untouched"
    assert not folder.remove_itself()
    assert folder.path.exists()


@pytest.mark.parametrize("name", ["../out", "/etc/passwd", "a/b", "", ".", ".."])
def test_a_name_never_leaves_the_folder(folder: PrivateFolder, name: str) -> None:
    for act in (folder.create, folder.open, folder.has, folder.remove, folder.read):
        with pytest.raises(ValueError, match="expected the name of a file in it"):
            act(name)


def test_a_folder_that_took_its_place_is_not_removed(folder: PrivateFolder, tmp_path: Path) -> None:
    folder.path.rename(tmp_path / "elsewhere")
    folder.path.mkdir()

    assert not folder.exists
    assert not folder.remove_itself()
    assert folder.path.is_dir()
