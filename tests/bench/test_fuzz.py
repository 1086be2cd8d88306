"""The fuzzer detects the failures that it searches for."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from bench.fuzz import genicam, tally
from bench.fuzz.descriptions import PROLOGUES, SMALL
from bench.fuzz.fuzz import fuzz
from bench.fuzz.genicam import fuzz_genicam, judged
from bench.fuzz.orders import fuzz_orders
from bench.fuzz.tally import Tally, Watch, alone
from pipeline import DriverError, GraphError
from pipeline.run.control_server import ControlServer


def test_a_traceback_a_hang_and_a_bad_sentence_are_each_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tally, "LONGEST_S", 0.05)
    found = Tally()

    def refuse() -> None:
        raise GraphError("two\nlines")

    found.check("a", lambda: 1 / 0)
    found.check("b", lambda: time.sleep(5))
    found.check("c", refuse)
    found.check("d", lambda: None)

    assert (found.tracebacks, found.hangs, found.bad_sentences, found.accepted) == (1, 1, 1, 1)
    assert not found.sound
    assert len(found.examples) == 3


def test_a_file_written_outside_the_folder_is_noticed(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    watch = Watch(inside)

    watch.on = True
    (inside / "a").write_text("x")
    outside.mkdir()
    (tmp_path / "b").write_text("x")
    (tmp_path / "b").read_text()
    watch.on = False

    assert watch.touched == {f"os.mkdir {outside}", f"open {tmp_path / 'b'}"}


def test_a_file_made_in_the_working_folder_or_at_home_is_noticed(tmp_path: Path) -> None:
    before = Path.cwd()

    with alone(tmp_path) as made:
        subprocess.run(["sh", "-c", "echo > here; mkdir ~/there; echo > ~/there/x"], check=True)

    assert made == {"here", "there", "there/x"}
    assert Path.cwd() == before


def test_a_program_that_is_started_is_noticed_and_this_python_is_not(tmp_path: Path) -> None:
    watch = Watch(tmp_path)

    watch.on = True
    subprocess.run([sys.executable, "-c", ""], check=True)
    subprocess.run(["/bin/true"], check=True)
    watch.on = False

    assert watch.touched == {"subprocess.Popen /bin/true"}


@pytest.mark.parametrize(
    "words",
    [
        ("wire", "--count", "50"),
        ("usb", "--count", "50"),
        ("genicam", "--count", "20"),
        ("orders", "--count", "8"),
    ],
)
def test_files_are_watched_whatever_is_fuzzed(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check, stray = Tally.check, tmp_path / "stray"

    def astray(self: Tally, *case: Any) -> None:
        check(self, case[0], lambda: stray.write_text("x"))

    monkeypatch.setattr(Tally, "check", astray)
    done = CliRunner().invoke(fuzz, words)

    assert done.exit_code == 1
    assert '"files_touched": 1' in done.output, done.output


def test_an_order_that_the_supervisor_fails_at_is_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("by design")

    monkeypatch.setattr(ControlServer, "take", fail)
    found = fuzz_orders(40, tmp_path)

    assert found.tracebacks >= 1
    assert any("by design" in str(example) for example in found.examples)


def test_the_command_counts_kinds_of_tracebacks_and_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    check = Tally.check
    monkeypatch.setattr(Tally, "check", lambda self, *case: check(self, case[0], lambda: 1 / 0))

    done = CliRunner().invoke(fuzz, ["wire", "--count", "3"])

    assert done.exit_code == 1
    assert '"ZeroDivisionError": 3' in done.output


def test_descriptions_are_read_judged_or_refused_in_a_sentence(tmp_path: Path) -> None:
    written = tmp_path / "camera.xml"
    written.write_bytes(SMALL)
    began_s = time.process_time()

    own, named = fuzz_genicam(300), fuzz_genicam(100, [written], seed=3)

    for found in (own, named):
        assert found.sound, found.examples
        assert min(found.accepted, found.refused) > 10
    assert time.process_time() - began_s < 30
    assert judged(SMALL) == "writes"


@pytest.mark.parametrize("prologue", PROLOGUES[:2])
def test_no_entity_is_expanded_and_no_file_is_read(prologue: bytes) -> None:
    text = SMALL.replace(b"<RegisterDescription", prologue + b"<RegisterDescription", 1)
    text = text.replace(b"<Value>640</Value>", b"<Value>&y;</Value>")

    with pytest.raises(DriverError, match="description of the camera: expected no document type"):
        judged(text)


def test_a_description_that_breaks_the_reader_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def deep(_text: bytes) -> None:
        raise RecursionError("by design")

    monkeypatch.setattr(genicam, "vetted_nodes", deep)
    found = fuzz_genicam(5)

    assert (found.tracebacks, found.sound) == (5, False)
    assert found.kinds == {"RecursionError": 5}
    assert "('small', 0)" in found.examples[0]


def test_the_command_prints_figures(tmp_path: Path) -> None:
    done = CliRunner().invoke(fuzz, ["wire", "--count", "50", "--json", str(tmp_path / "f.json")])

    assert done.exit_code == 0, done.output
    assert '"cases": 50' in done.output
    assert '"commit"' in (tmp_path / "f.json").read_text()
