"""Files that an evaluation writes: where they go, and that they are whole."""

from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from bench.options import new_file
from bench.outputs import make_room, work_folder, write_figure
from pipeline import SettingsError


def test_finished_units_are_beside_the_report() -> None:
    assert work_folder(None, Path("a/b.json"), "text.work") == Path("a/b.work")
    assert work_folder(None, None, "text.work") == Path("text.work")
    assert work_folder(Path("kept"), Path("a/b.json"), "text.work") == Path("kept")


@pytest.mark.parametrize("report", ["", ".", "/"])
def test_a_report_without_a_name_is_refused(report: str) -> None:
    with pytest.raises(SettingsError, match=r"^report: expected a file, got [./]$"):
        work_folder(None, Path(report), "text.work")


def test_markdown_alone_is_printed(tmp_path: Path) -> None:
    make_room(tmp_path, markdown=Path("-"))

    with pytest.raises(SettingsError, match="report: expected a file, got -"):
        make_room(tmp_path, report=Path("-"))


@pytest.mark.parametrize(("name", "begins"), [("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")])
def test_a_picture_is_written_whole_or_its_file_is_told(
    name: str, begins: bytes, tmp_path: Path
) -> None:
    figures = pytest.importorskip("matplotlib.figure", reason="needs the eval extra")
    figure = figures.Figure(figsize=(2, 2))

    write_figure(figure, tmp_path / name)

    assert (tmp_path / name).read_bytes().startswith(begins)
    with pytest.raises(OSError, match="none"):
        write_figure(figure, tmp_path / "none" / name)


def test_a_bench_is_told_before_it_works_that_its_file_cannot_be_written(tmp_path: Path) -> None:
    assert new_file(str(tmp_path / "new" / "a.json")).parent.is_dir()

    for path in (str(tmp_path), "/dev/null"):
        with pytest.raises(ArgumentTypeError, match="cannot be written"):
            new_file(path)
