"""What every test may count on."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


@pytest.fixture
def shared() -> Path:
    """Real footage beside the checkout; the test is skipped where there is none."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("no real footage beside this checkout")
    return folder


@pytest.fixture
def snmot(shared: Path) -> Path:
    """The SoccerNet sequence."""
    folder = shared / "data" / "soccernet" / "SNMOT-116a"
    if not folder.is_dir():
        pytest.skip("no SoccerNet sequence beside this checkout")
    return folder
