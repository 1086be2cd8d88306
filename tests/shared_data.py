"""Recordings and third-party weights kept beside the repository, for tests marked `footage`."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.weights import pull


@dataclass(frozen=True)
class Footage:
    """The shared folder. What it lacks skips the test that asks for it."""

    folder: Path

    def data(self, part: str) -> Path:
        """A recording or a folder of some."""
        return self._there(self.folder / "data" / part)

    def mirror(self) -> Path:
        """Where third-party weights are taken from in place of the network."""
        return self._there(self.folder / "models")

    def weights(self, name: str) -> Path:
        """Third-party weights by the name of the manifest, pulled into this test's cache."""
        (path,) = pull([name], self.mirror())
        return path

    def _there(self, path: Path) -> Path:
        if not path.exists():
            pytest.skip(f"no footage: {path} is not there")
        return path
