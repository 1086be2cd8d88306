"""Recordings and third-party weights kept beside the repository, for tests marked `footage`."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.weights import pull


@dataclass(frozen=True)
class Footage:
    """The shared folder; a test that needs a missing part of it is skipped."""

    folder: Path

    def data(self, part: str) -> Path:
        """Return a recording or a folder of recordings."""
        return self._there(self.folder / "data" / part)

    def mirror(self) -> Path:
        """Return the folder that replaces the network as the origin of third-party weights."""
        return self._there(self.folder / "models")

    def weights(self, name: str) -> Path:
        """Pull third-party weights by their name in the manifest into the cache of this test."""
        (path,) = pull([name], self.mirror())
        return path

    def _there(self, path: Path) -> Path:
        if not path.exists():
            pytest.skip(f"no footage: {path} is not there")
        return path
