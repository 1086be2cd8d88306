"""A wheel is complete: it is built from the source tree, unpacked elsewhere, and run from there."""

import email
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.test_house_rules import ROOT

pytestmark = pytest.mark.skipif(
    find_spec("setuptools") is None, reason="building needs setuptools, which is not installed"
)
ROOMS = ("pipeline", "operators", "drivers", "bench", "graphs")
COPIED = (*ROOMS, "pyproject.toml", "README.md", "LICENSE")
# files of the folders that belong in the wheel
TAKEN = (".py", ".yaml", ".onnx", ".toml", ".txt", ".c")
OWN = ("-c", "user.name=tester", "-c", "user.email=tester@localhost")


def git(folder: Path, *words: str) -> str:
    command = ["git", "-C", str(folder), *OWN, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the source tree and put it under git, so that building leaves the original as it is."""
    folder = tmp_path_factory.mktemp("source")
    junk = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=junk)
        else:
            shutil.copy(ROOT / name, folder / name)
    git(folder, "init", "--quiet")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "all")
    return folder


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a wheel as `pip wheel` does, without an isolated environment, which needs a network."""
    folder = tmp_path_factory.mktemp("dist")
    build = f"from setuptools.build_meta import build_wheel; build_wheel({str(folder)!r})"
    done = subprocess.run([sys.executable, "-c", build], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("site")
    zipfile.ZipFile(wheel).extractall(folder)
    yield folder
    shutil.rmtree(folder)


def fovea(installed: Path, cwd: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run the unpacked command in an unrelated folder."""
    return subprocess.run(
        [sys.executable, "-m", "pipeline.entry", *words], cwd=cwd, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(installed)}, check=False,
    )  # fmt: skip


@pytest.mark.lengthy
def test_the_wheel_contains_every_module_graph_network_and_type_marker(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    api = "pipeline/api/"
    wanted = {
        path.relative_to(ROOT).as_posix().removeprefix(api)
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.suffix in TAKEN or path.name == "py.typed"
    }

    assert wanted <= inside, sorted(wanted - inside)
    assert {"fovea/__init__.py", "fovea/py.typed", "graphs/tracking.yaml"} <= inside
    tops = {name.partition("/")[0] for name in inside}
    assert {top for top in tops if not top.endswith(".dist-info")} == {*ROOMS, "fovea"}
    assert not [name for name in inside if name.startswith((api, "tests/", "build/"))]


@pytest.mark.lengthy
def test_the_wheel_requires_what_running_a_graph_needs_and_has_extras_for_the_rest(
    wheel: Path,
) -> None:
    archive = zipfile.ZipFile(wheel)
    (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
    asked = email.message_from_bytes(archive.read(name)).get_all("Requires-Dist", [])

    always = {word.partition(">")[0].partition("<")[0] for word in asked if "extra ==" not in word}
    assert {"numpy", "eclipse-zenoh", "onnxruntime"} <= always
    extras = ("cryptography", "matplotlib", "torch", "onnx", "filterpy", "pyusb")
    assert not always & set(extras)


@pytest.mark.lengthy
def test_the_version_of_a_wheel_includes_its_commit(
    source: Path, installed: Path, tmp_path: Path
) -> None:
    commit = git(source, "rev-parse", "--short=12", "HEAD")

    said = fovea(installed, tmp_path, "--version").stdout

    assert said.endswith(f" (commit {commit})\n")


@pytest.mark.lengthy
def test_a_source_distribution_contains_the_commit_for_wheels_built_from_it(
    source: Path, tmp_path: Path
) -> None:
    build = f"from setuptools.build_meta import build_sdist; build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    shutil.unpack_archive(archive, tmp_path)

    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    recorded = (folder / "pipeline" / "commit.txt").read_text().strip()
    assert recorded == git(source, "rev-parse", "--short=12", "HEAD")
    assert (folder / "graphs" / "tracking.yaml").is_file()
    assert (folder / "pipeline" / "recorded_commit.py").is_file()


@pytest.mark.lengthy
def test_the_shipped_graph_is_found_and_fits_from_any_folder(
    installed: Path, tmp_path: Path
) -> None:
    done = fovea(installed, tmp_path, "check", "tracking")

    assert done.returncode == 0, done.stderr
    assert str(installed / "graphs" / "tracking.yaml") in done.stdout.replace("\n", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.lengthy
@pytest.mark.slow
@pytest.mark.parametrize("way", ["--inline", "--clock=lockstep"])
def test_the_shipped_graph_runs_from_any_folder(installed: Path, tmp_path: Path, way: str) -> None:
    done = fovea(installed, tmp_path, "run", "tracking", way, "--frames", "10")

    assert done.returncode == 0, done.stderr
    assert "frames/s over 10 frames" in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.lengthy
@pytest.mark.slow
def test_a_script_runs_a_shipped_example(installed: Path, tmp_path: Path) -> None:
    script = (
        "import fovea; print(fovea.__file__, fovea.load('examples/blend').run(frames=5)['graph'])"
    )
    env = {**os.environ, "PYTHONPATH": str(installed)}

    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=env, capture_output=True, text=True
    )

    assert done.stdout == f"{installed / 'fovea' / '__init__.py'} blend\n", done.stderr
