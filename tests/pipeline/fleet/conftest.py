"""Fixtures of every test of the fleet."""

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the record of deployed graphs apart from that of this user."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
