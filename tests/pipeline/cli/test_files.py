"""Paths of reports and recordings are tried before a run; unwritable ones are refused."""

import json
import os
import re
import secrets
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from pipeline import SettingsError
from pipeline.cli.files import try_recording, try_report, write_report
from tests.commands import command
from tests.pipeline.run.namespaces import with_small_mounts
from tests.sample_graphs import CHAIN

FOVEA = (sys.executable, "-m", "pipeline.cli")
VIEWER = """\
  viewer:
    operator: operators.visualise:Visualise
    manual: true
    inputs: {context: ticker.context}
"""
CHECK = """
import sys, warnings
from rerun.chunk import RrdReader
warnings.simplefilter("ignore")
from pipeline.cli import main
path = sys.argv.pop(1)
try:
    main()
finally:
    frames = set()
    try:
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            if "frame" in batch.schema.names:
                frames |= set(batch.column("frame").to_pylist())
    except RuntimeError as error:  # as the message of the run has to say then
        print("unreadable:", error, file=sys.stderr)
    print("newest", max((f for f in frames if f is not None), default=-1))
"""


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: files-{secrets.token_hex(3)}\n{CHAIN}{VIEWER}")
    return path


@pytest.mark.parametrize("option", ["--report", "--save"])
def test_what_cannot_be_written_is_refused_before_anything_runs(
    graph: Path, tmp_path: Path, option: str
) -> None:
    (tmp_path / "file").write_text("x")

    for path in (tmp_path, tmp_path / "file" / "x.json", Path("/proc/x/y"), Path("/proc/x")):
        done = command("run", str(graph), option, str(path))

        assert done.returncode == 2
        assert done.stderr.startswith(f"fovea: {option} {path}: cannot be written: ")
        assert done.stderr.count("\n") == 1
        assert done.stdout == ""


@pytest.mark.parametrize("attempt", [try_report, try_recording])
def test_trying_changes_nothing(tmp_path: Path, attempt: object) -> None:
    old = tmp_path / "old.json"
    old.write_text("old")

    attempt(old, "--report")  # type: ignore[operator]
    attempt(tmp_path / "new.json", "--report")  # type: ignore[operator]

    assert [p.name for p in tmp_path.iterdir()] == ["old.json"]
    assert old.read_text() == "old"


def test_trying_a_report_leaves_no_folder_and_writing_it_makes_them(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "c" / "report.json"

    try_report(path, "--report")

    assert list(tmp_path.iterdir()) == []
    assert write_report(path, {"a": 1}, "--report") == ""
    assert json.loads(path.read_text()) == {"a": 1}


def test_folders_that_were_there_stay(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)

    try_report(tmp_path / "a" / "b" / "c" / "report.json", "--report")

    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b"]
    assert list((tmp_path / "a" / "b").iterdir()) == []


def test_a_run_that_is_refused_leaves_no_folder(graph: Path, tmp_path: Path) -> None:
    graph.write_text("nodes: {}")

    report = tmp_path / "new" / "deep" / "report.json"
    done = command("run", str(graph), "--report", str(report))

    assert done.returncode == 2
    assert [p.name for p in tmp_path.iterdir()] == ["graph.yaml"]


def test_an_old_report_stays_when_the_graph_is_wrong(graph: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    report.write_text("old")
    graph.write_text("nodes: {}")

    done = command("run", str(graph), "--report", str(report))

    assert done.returncode == 2
    assert report.read_text() == "old"


def test_a_report_goes_through_a_link_and_into_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "target")
    read, write = os.pipe()

    for path in (tmp_path / "link", Path(f"/dev/fd/{write}")):
        try_report(path, "--report")
        assert write_report(path, {"a": 1}, "--report") == ""

    assert (tmp_path / "link").is_symlink()
    assert json.loads((tmp_path / "target").read_text()) == {"a": 1}
    assert json.loads(os.read(read, 1000)) == {"a": 1}
    os.close(read)
    os.close(write)


def test_a_pipe_without_a_reader_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(SettingsError, match="cannot be written"):
        try_report(tmp_path / "pipe", "--report")


def test_a_report_that_does_not_fit_is_printed_and_the_old_one_stays(
    graph: Path, tmp_path: Path
) -> None:
    small = tmp_path / "small"
    small.mkdir()
    script = (
        "import sys; from pathlib import Path; from pipeline.cli import main\n"
        "folder = Path(sys.argv.pop(1))\n"
        "(folder / 'report.json').write_text('old')\n"
        "try: (folder / 'filler').write_bytes(bytes(1 << 20))\n"
        "except OSError: pass\n"
        "try: main()\n"
        "finally: print('left:', (folder / 'report.json').read_text(), sorted(folder.iterdir()))\n"
    )
    words = ("run", str(graph), "--inline", "--frames", "5", "--report", str(small / "report.json"))

    done = with_small_mounts({small: "64k"}, "-c", script, str(small), *words)

    assert done.returncode == 2, done.stderr
    assert "report.json: cannot be written: No space left on device" in done.stderr
    assert '"graph": "files-' in done.stdout
    assert "left: old" in done.stdout
    assert ".part" not in done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "words", [("--inline",), ("--clock", "lockstep")], ids=["in line", "as processes"]
)
def test_a_recording_whose_disk_fills_is_an_error_and_can_be_read_up_to_there(
    graph: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    small = tmp_path / "small"
    small.mkdir()
    done = with_small_mounts(
        {small: "100k"}, "-c", CHECK, str(small / "x.rrd"), "run", str(graph), *words, "--frames",
        "400", "--save", str(small / "x.rrd"), "--set", "ticker.side_px=700", "--set",
        "viewer.jpeg_quality=100", timeout_s=120,
    )  # fmt: skip

    assert done.returncode == 2, done.stdout + done.stderr
    found = re.search(r"x\.rrd: the disk is full; (?:it can be read up to frame (\d+)|nothing)",
                      done.stderr)  # fmt: skip
    assert found
    assert f"newest {found[1] or -1}\n" in done.stdout
    assert "Traceback" not in done.stderr


def test_a_path_to_record_to_is_taken_as_it_is(graph: Path, tmp_path: Path) -> None:
    path = tmp_path / "a #: {b.rrd"

    done = subprocess.run(
        [*FOVEA, "run", str(graph), "--inline", "--frames", "3", "--save", str(path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert list(RrdReader(path).stream())


def test_a_full_standard_output_is_told_in_plain_words() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "pipeline.entry", "ps"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip

    assert (done.returncode, done.stderr) == (1, "fovea: No space left on device\n")
