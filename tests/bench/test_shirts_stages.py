"""Where numbers are lost: few of them, with the real readers."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("rapidocr")

from bench.shirts.stages import main, median, share


def test_each_reader_is_asked_about_each_legible_number(tmp_path: Path) -> None:
    words = ["--matches", "1", "--frames", "1", "--seed", "50004"]

    result = CliRunner().invoke(main, [*words, "--report", str(tmp_path / "r.json")])

    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "r.json").read_text())
    shares = [row["share"] for row in found["rows"]]
    assert found["numbers"] >= 2
    assert len(shares) == 5
    assert shares[3] > shares[4]  # full resolution, and the context


def test_of_nothing_there_is_no_share() -> None:
    assert share([]) is None
    assert median([]) is None
    assert share([True, False]) == 0.5
