"""What a supervisor holds does not depend on how many nodes it has seen end."""

import json
from pathlib import Path

from click.testing import CliRunner

from bench.endure import main


def test_no_file_or_process_is_left_of_what_was_killed_or_swapped(
    tmp_path: Path,
) -> None:
    figures = tmp_path / "endure.json"

    done = CliRunner().invoke(main, ["--kills", "2", "--swaps", "2", "--json", str(figures)])

    assert done.exit_code == 0, done.output
    found = json.loads(figures.read_text())
    first, last = found["looks"][0], found["looks"][-1]
    assert [last["events"], found["refused"]] == [4, []]
    for name in ("run_files", "memory_files", "children"):
        assert last[name] <= first[name], name
    assert (found["unbalanced"], found["left"], found["orphans"]) == ([], [], [])
