"""What every test may count on."""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from pipeline.run.leftovers import cleanup

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

# The usual run draws the same examples every time; `make test-slow` goes looking for others.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, derandomize=False, deadline=None)
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def own_runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Each test process has its own place for graphs, away from those that this user runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(tmp_path_factory.getbasetemp()))
        patch.setattr(tempfile, "tempdir", None)
        yield
        cleanup()


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
