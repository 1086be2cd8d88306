"""Build steps that record the commit of the source tree in `pipeline/commit.txt`.

Only `pyproject.toml` refers to them. setuptools loads this file on its own, before the project can
be imported.
"""

import importlib.util
from pathlib import Path
from types import ModuleType

from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent


class BuildWithCommit(build_py):
    """Copies the packages and the commit into a wheel; an editable installation asks git."""

    def run(self) -> None:
        """Copy, then record."""
        super().run()
        if not self.editable_mode:
            _record(Path(self.build_lib))


class SourceWithCommit(sdist):
    """Packs the sources with the commit, since a wheel built from them has no git to ask."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Copy, then record."""
        super().make_release_tree(base_dir, files)
        _record(Path(base_dir))


def _record(root: Path) -> None:
    version = _version()
    if found := version.commit():
        (root / "pipeline" / version.RECORD).write_text(f"{found}\n", encoding="utf-8")


def _version() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fovea_version", HERE / "version.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
