"""Where numbers are lost: few of them, with the real readers."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("rapidocr")

from bench.shirts.stages import Readers, main, median, share


@pytest.mark.lengthy
def test_each_reader_is_asked_about_each_legible_number(tmp_path: Path) -> None:
    words = ["--matches", "1", "--frames", "1", "--seed", "50004"]

    result = CliRunner().invoke(main, [*words, "--report", str(tmp_path / "r.json")])

    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "r.json").read_text())
    shares = [row["share"] for row in found["rows"]]
    assert found["numbers"] >= 2
    assert len(shares) == 5
    assert shares[3] > shares[4]  # full resolution, and the context


@pytest.mark.parametrize("words", [("--matches", "0"), ("--every", "0"), ("--seed", "-1")])
def test_what_cannot_be_looked_at_is_refused(words: tuple[str, str]) -> None:
    result = CliRunner().invoke(main, words)

    assert result.exit_code == 2
    assert f"Invalid value for '{words[0]}'" in result.output


def test_each_match_has_its_own_texts_in_the_context() -> None:
    readers = Readers()
    looked: list[int] = []

    class Match:
        def window(self, index: int, *given: object) -> None:
            looked.append(index)

    for seed, index in ((1, 0), (1, 0), (2, 0), (2, 30)):
        readers._found(Match(), seed, index)  # type: ignore[arg-type]

    assert looked == [0, 0, 30]


def test_of_nothing_there_is_no_share() -> None:
    assert share([]) is None
    assert median([]) is None
    assert share([True, False]) == 0.5
