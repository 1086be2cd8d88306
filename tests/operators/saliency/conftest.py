"""Fixtures of the tests of the detector and its training."""

from pathlib import Path

import pytest

from operators.saliency.pasting import Bank
from operators.saliency.stills import stills
from tests.operators.training.labelled_stills import match_of_stills


@pytest.fixture
def bank(tmp_path: Path) -> Bank:
    """One still with a ball, two players and a referee."""
    folder = stills(match_of_stills(tmp_path, "aa_1"))
    example = folder.example(folder.files[0])
    return Bank(count=1, still=lambda _: example)
