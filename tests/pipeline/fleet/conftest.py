"""What every test of the fleet may count on."""

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is remembered of deployed graphs lies apart from what this user deployed."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
