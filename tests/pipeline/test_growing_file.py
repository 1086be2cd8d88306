"""A recording that stops is cut where it was whole; another file under its name is left alone."""

from pathlib import Path

from pipeline.growing_file import GrowingFile


def stopped(path: Path, grown: bytes, meanwhile: bytes | None = None) -> GrowingFile:
    """A recording whose writer stops after some more bytes; another file may take its name."""
    answers = iter([True, False, False])
    path.write_bytes(b"whole")
    file = GrowingFile(path, lambda _: next(answers))
    file.look(7)
    with path.open("ab") as opened:
        opened.write(grown)
    if meanwhile is not None:
        path.rename(path.with_name("moved"))
        path.write_bytes(meanwhile)
    file.look(8)
    file.look(9)
    return file


def test_it_is_cut_where_it_was_whole_last(tmp_path: Path) -> None:
    file = stopped(tmp_path / "x.rrd", b"torn")

    assert (tmp_path / "x.rrd").read_bytes() == b"whole"
    assert "it can be read up to frame 7" in file.failure


def test_another_file_that_has_taken_its_name_is_not_cut(tmp_path: Path) -> None:
    file = stopped(tmp_path / "x.rrd", b"torn", meanwhile=b"of the user, and longer")

    assert (tmp_path / "x.rrd").read_bytes() == b"of the user, and longer"
    assert file.failure
