"""Real footage beside the repository, for tests that skip without it."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared(part: str) -> Path:
    """A file or folder of the shared data; skips the test where it is absent."""
    path = SHARED / part
    if not path.exists():
        pytest.skip(f"needs real footage in ../shared/data/{part}, which is not here")
    return path
