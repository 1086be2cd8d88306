"""Environment of every test: an empty home, no variables of the user, private folders."""

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from pipeline.run.leftovers import cleanup
from tests.shared_data import Footage

ROOT = Path(__file__).resolve().parent.parent
# Variables of a shell, a terminal, a proxy or a git hook that would change results.
OF_THE_USER = re.compile(
    r"XDG_.*|GIT_.*|ZENOH_.*|RUST_LOG|LANG|LANGUAGE|LC_.*|COLUMNS|LINES|JUPYTER_.*|"
    r"(NO|FORCE|CLICOLOR_FORCE|CLICOLOR|PY)_?COLORS?|TTY_.*|(?i:(http|https|ftp|all|no)_proxy)|"
    r"MPLCONFIGDIR|MPLBACKEND|TEMP|TMP|"
    r"PYTHONDONTWRITEBYTECODE"  # each of a thousand processes would compile what it imports
)
LONGEST_FOLDER = 24  # characters: the path of a socket has at most 107, and names follow

# The usual run draws the same examples every time; `make test-slow` searches for others.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, derandomize=False, deadline=None)
settings.load_profile("same")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options for footage and third-party weights, and for a USB board."""
    parser.addoption(
        "--shared", type=Path, default=ROOT.parent / "shared", metavar="PATH",
        help="folder of recordings and weights for tests marked `footage` (default: %(default)s)",
    )  # fmt: skip
    parser.addoption(
        "--usb-board", action="append", choices=("attached", "usbip", "gadget"), default=[],
        help="board of tests marked `hardware`: the one on the desk (the default), or a virtual one"
        " over USB/IP or as a gadget; may be given more than once",
    )  # fmt: skip
    parser.addoption(
        "--camera", default="", metavar="PATH",
        help="V4L2 device for tests of webcams marked `hardware`, e.g. /dev/video0",
    )  # fmt: skip


def pytest_configure() -> None:
    """Remove variables of the user from this process and from those that it starts."""
    for name in filter(OF_THE_USER.fullmatch, list(os.environ)):
        del os.environ[name]
    os.environ["LC_ALL"] = "C.UTF-8"
    own = [str(ROOT), str(ROOT / "pipeline" / "api")]  # the latter has the package fovea
    paths = [*own, *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    sys.path[:0] = own


@pytest.fixture(scope="session", autouse=True)
def own_place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Give each test process an empty home and a folder for graphs with a short path."""
    tmp_path_factory.getbasetemp()  # made in the folder of the user's settings, before they change
    short = Path(tempfile.mkdtemp(prefix="fovea-", dir=_parent()))
    (short / "home").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(short / "home"))
        patch.setenv("TMPDIR", str(short))
        patch.setattr(tempfile, "tempdir", None)
        yield
        cleanup()
    shutil.rmtree(short, ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def one_thread_of_torch() -> None:
    """Limit torch to one thread; several spin while waiting and slow 0.2 s to half a minute."""
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)


@pytest.fixture
def short_path() -> Iterator[Path]:
    """Yield a folder like `tmp_path`, with a path short enough for sockets in it."""
    folder = Path(tempfile.mkdtemp(prefix="t"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def footage(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Footage:
    """Return recordings and weights for a test marked `footage`; skip it where there are none."""
    if request.node.get_closest_marker("footage") is None:
        pytest.fail(f"{request.node.name}: expected the mark `footage` on it, got none")
    folder: Path = request.config.getoption("--shared")
    if not folder.is_dir():
        pytest.skip(f"no footage: {folder} is not a folder; --shared=PATH says where it is")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))  # pulled weights are for this test only
    return Footage(folder)


def _parent() -> str:
    usual = tempfile.gettempdir()
    return usual if len(usual) <= LONGEST_FOLDER else "/tmp"
