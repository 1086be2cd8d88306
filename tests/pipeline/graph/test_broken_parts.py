"""An error in a user's module or class is reported in one sentence with the line of its cause."""

import re
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from operators.capture import CaptureSettings
from pipeline import FoveaError, GraphError, SettingsError
from pipeline.extras import EXTRAS
from pipeline.graph.editing import with_nodes
from pipeline.graph.loader import load
from pipeline.graph.plan import load_operator
from pipeline.import_path import imported
from pipeline.settings import build
from tests.broken_parts import CLASSES, ENDING, HANDLER, HEAD, METHODS, MODULES
from tests.commands import command
from tests.sample_graphs import CHAIN

FOVEA = (sys.executable, "-m", "pipeline.cli")
SLOW_TOO = pytest.mark.slow  # cases that differ from a usual one by the command alone
EXTRA = "  extra:\n    operator: {}\n    settings: {{}}\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the file of a module with a new name, in a folder that Python imports from."""
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / f"mine_{secrets.token_hex(4)}.py"
    yield path
    sys.modules.pop(path.stem, None)


def graph_of(module: Path) -> Path:
    path = module.parent / "graph.yaml"
    path.write_text(f"name: toy\n{CHAIN}" + EXTRA.format(f"{module.stem}:Part"))
    return path


@pytest.mark.parametrize(("text", "line", "said"), MODULES.values(), ids=MODULES)
def test_a_module_that_breaks_is_told_with_the_line_of_the_cause(
    module: Path, text: str, line: int, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    module.write_text(text)
    path = graph_of(module)

    with pytest.raises(GraphError) as caught:
        load(path)

    sentence = str(caught.value)
    assert sentence.startswith(f"{path}:{CHAIN.count(chr(10)) + 3}: extra.operator: ")
    assert f" cannot be imported: {module}:{line}: {said}" in sentence
    assert "\n" not in sentence
    assert len(sentence) < 1000
    assert capfd.readouterr().out == ""


def test_an_addition_whose_module_breaks_is_refused_with_its_line(module: Path) -> None:
    module.write_text("1 / 0\n")
    graph = graph_of(module)
    addition = module.parent / "more.yaml"
    addition.write_text("nodes:\n" + EXTRA.format(f"{module.stem}:Part"))
    graph.write_text(f"name: toy\n{CHAIN}")

    with pytest.raises(GraphError, match=rf"more\.yaml:3: .*{module}:1: ZeroDivisionError"):
        with_nodes(load(graph), addition)


def test_a_sensor_whose_module_breaks_is_refused_with_its_line(module: Path) -> None:
    module.write_text("\nimport sys; sys.exit('no')\n")

    with pytest.raises(SettingsError, match=rf"capture\.sensor: .*{module}:2: it exits: no"):
        build(CaptureSettings, {"sensor": f"{module.stem}:Part"}, "capture")


@pytest.mark.parametrize("text", CLASSES.values(), ids=CLASSES)
def test_a_class_with_broken_declarations_is_refused_in_one_sentence(
    module: Path, text: str
) -> None:
    module.write_text(HEAD + text)
    path = graph_of(module)

    with pytest.raises(FoveaError) as caught:
        load(path)

    assert str(caught.value).startswith(f"{path}:"), str(caught.value)
    assert f"{module.stem}:Part" in str(caught.value) or "broke" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("method", "said"), METHODS.values(), ids=METHODS)
def test_a_method_that_cannot_be_called_as_it_is_called_is_refused(
    module: Path, method: str, said: str
) -> None:
    module.write_text(HEAD + HANDLER.format(method))

    with pytest.raises(GraphError, match=f"^{re.escape(f'{module.stem}:Part.{said}')}$"):
        load_operator(f"{module.stem}:Part")


@pytest.mark.parametrize(
    "method",
    [
        "def on_frame(self, frame, more=1): pass",
        "def on_frame(self, **messages): pass",
        "@staticmethod\n    def on_frame(frame): pass",
        "@classmethod\n    def on_frame(cls, frame): pass",
        "on_frame = functools.partialmethod(lambda self, more, frame: None, 1)",
        "@wrapped\n    def on_frame(self, frame, more): pass",
        "on_frame = property(lambda self: self._handle)",
        "on_frame = dict",
        "def __init__(self, settings, *, more=1): super().__init__(settings)",
    ],
)
def test_a_method_that_can_be_called_so_is_taken_however_it_is_made(
    module: Path, method: str
) -> None:
    wrapped = (
        "import functools\n"
        "def wrapped(method):\n"
        "    @functools.wraps(method)\n"
        "    def call(self, frame):\n"
        "        return method(self, frame, 1)\n"
        "    return call\n"
    )
    module.write_text(HEAD + wrapped + HANDLER.format(method))

    load_operator(f"{module.stem}:Part")


def test_a_text_that_is_no_import_path_is_not_imported() -> None:
    for path in ("", ":", "a:", ":b", "..a:b", "a b:c", "a:b.c", "a/b:c", "a:b:c", "a\0:b"):
        with pytest.raises(GraphError, match="expected an import path module:Class, got"):
            imported(path, GraphError)


def test_an_object_that_is_no_operator_is_refused() -> None:
    with pytest.raises(GraphError, match="json:dumps: expected an Operator, got <function"):
        load_operator("json:dumps")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        pytest.param(name, words, marks=[] if name == "exits" or words[0] == "run" else SLOW_TOO)
        for name in ("exits", "is no Python", "raises an interrupt", *ENDING)
        for words in (["check"], ["run", "--report", "report.json"])
    ],
)
def test_check_and_run_end_with_2_and_the_sentence(
    module: Path, name: str, words: list[str]
) -> None:
    text, line, said = {**MODULES, **ENDING}[name]
    module.write_text(text)
    path = graph_of(module)

    done = subprocess.run(
        [*FOVEA, *words, path.name], cwd=module.parent, capture_output=True, text=True,
        check=False, env={"PYTHONPATH": str(Path.cwd()), "TMPDIR": str(module.parent)},
    )  # fmt: skip

    assert done.returncode == 2, done.stderr
    assert f"{module.name}:{line}: {said}" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_a_module_that_crashes_the_command_is_reported_with_its_line(module: Path) -> None:
    module.write_text("import ctypes\n\nctypes.string_at(0)\n")
    path = graph_of(module)

    done = subprocess.run(
        [*FOVEA, "check", path.name], cwd=module.parent, capture_output=True, text=True,
        check=False, env={"PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip

    assert done.returncode == -signal.SIGSEGV
    told = ascii(str(module))[1:-1]  # as `faulthandler` writes a path
    assert f'File "{told}", line 3 in <module>' in done.stderr


def test_a_process_that_an_operators_module_forks_may_end_by_exit(module: Path) -> None:
    module.write_text("import os\nif not os.fork():\n    os._exit(7)\n"
                      "raise ValueError(os.waitstatus_to_exitcode(os.wait()[1]))\n")  # fmt: skip
    path = graph_of(module)

    done = subprocess.run(
        [*FOVEA, "check", path.name], cwd=module.parent, capture_output=True, text=True,
        check=False, env={"PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip

    assert done.stderr.endswith(f"{module}:4: ValueError: 7\n")
    assert done.returncode == 2


def test_ctrl_c_during_an_import_is_not_reported_as_an_error_of_the_module(module: Path) -> None:
    module.write_text("import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(9)")
    path = graph_of(module)

    done = subprocess.run(
        [*FOVEA, "check", path.name], cwd=module.parent, capture_output=True, text=True,
        check=False, env={"PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip

    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert "cannot be imported" not in done.stderr


def test_a_check_without_imports_imports_nothing_and_names_what_a_run_would_import(
    module: Path,
) -> None:
    mark = module.parent / "imported"
    module.write_text(f"open({str(mark)!r}, 'w')\n")
    path = graph_of(module)
    path.write_text(
        path.read_text().replace("settings: {}", "settings: {sensor: my.own:Sensor, deep: [x.y:Z]}")
    )

    done = subprocess.run(
        [*FOVEA, "check", "--no-import", path.name], cwd=module.parent, capture_output=True,
        text=True, check=False, env={"PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    named = {f"extra: {p}" for p in (f"{module.stem}:Part", "my.own:Sensor", "x.y:Z")}
    assert named <= {line.strip() for line in done.stdout.splitlines()}
    assert "operators were not checked" in done.stdout
    assert not mark.exists()
    assert module.stem not in sys.modules


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("frame: ticker.roi", "frame: tiker.roi", "no node tiker, did you mean 'ticker'"),
        ("  glance:", "  ../glance:", "expected up to 32 letters"),
        ("depth: 60", "depth: 0", "expected 1 to 64"),
        ("operator: tests.samples:Count", "operator: 5", "expected an import path"),
        ("name: toy", "nam: toy", "did you mean 'name'"),
    ],
)
def test_a_check_without_imports_checks_names_numbers_and_edges(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = tmp_path / "graph.yaml"
    text = f"name: toy\n{CHAIN}"
    assert old in text
    path.write_text(text.replace(old, new))

    done = command("check", "--no-import", str(path))

    assert done.returncode == 2
    assert f"fovea: {path}:" in done.stderr
    assert said in done.stderr


def test_a_module_that_needs_an_extra_names_the_extra(
    module: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXTRAS, "no_such_package", "usb")
    module.write_text("import no_such_package.core\n")

    with pytest.raises(SettingsError) as refusal:
        imported(f"{module.stem}:Sensor", SettingsError, "sensor")

    assert str(refusal.value) == (
        f"sensor: {module.stem}:Sensor cannot be imported: expected the package no_such_package, "
        "got none: pip install 'fovea[usb]'"
    )
