"""A supervisor's resources do not grow with the number of nodes that have ended."""

import json
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.endure import main
from bench.results import __file__ as results


def own_threads() -> set[threading.Thread]:
    """Return the threads of this process except Zenoh's, which start with work and stay."""
    return {t for t in threading.enumerate() if not isinstance(t, threading._DummyThread)}


@pytest.mark.lengthy
def test_no_file_or_process_is_left_of_what_was_killed_or_swapped(
    tmp_path: Path,
) -> None:
    figures, before = tmp_path / "endure.json", own_threads()

    done = CliRunner().invoke(main, ["--kills", "2", "--swaps", "2", "--json", str(figures)])

    assert done.exit_code == 0, done.output
    found = json.loads(figures.read_text())
    first, last = found["looks"][0], found["looks"][-1]
    assert [last["events"], found["refused"]] == [4, []]
    for name in ("run_files", "memory_files", "children", "open_files"):
        assert last[name] <= first[name], name
    assert own_threads() <= before
    assert (found["unbalanced"], found["left"], found["orphans"]) == ([], [], [])


def test_in_the_committed_run_of_thousands_nothing_grows() -> None:
    looks = json.loads(Path(results).with_name("endure.json").read_text())["looks"][1:]
    half = len(looks) // 2

    assert looks[-1]["events"] > 3000
    for name in ("open_files", "threads", "children", "run_files", "memory_files"):
        early, late = ([x[name] for x in part] for part in (looks[:half], looks[half:]))
        assert max(late) <= max(early), name
