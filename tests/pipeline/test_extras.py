"""Packages of extras are imported late; a missing one is named with its install command."""

import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from pipeline.errors import InstallError
from pipeline.extras import EXTRAS, PACKAGES, LateModule, need

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


def test_every_package_is_installed_by_the_extra_that_is_named() -> None:
    project = tomllib.loads(PROJECT.read_text())["project"]
    asked = {
        extra: {Requirement(r).name for r in project["optional-dependencies"][extra]}
        for extra in set(EXTRAS.values())
    }
    always = {Requirement(r).name for r in project["dependencies"]}

    installed = {PACKAGES.get(name, name): extra for name, extra in EXTRAS.items()}
    assert all(package in asked[extra] for package, extra in installed.items())
    assert not always & set(installed)


def test_a_late_module_is_imported_when_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    late = LateModule("colorsys")
    looked_at = hasattr(late, "__wrapped__")  # as doctest does
    before = "colorsys" in sys.modules

    assert late.rgb_to_hsv(0, 0, 0) == (0.0, 0.0, 0)
    assert (looked_at, before, "colorsys" in sys.modules) == (False, False, True)


def test_a_missing_package_is_reported_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    need("numpy", "here")
    monkeypatch.setitem(sys.modules, "matplotlib", None)

    with pytest.raises(InstallError) as refused:
        need("matplotlib", "--plot")

    assert str(refused.value) == (
        "--plot: expected the package matplotlib, got none: pip install 'fovea[eval]'"
    )
