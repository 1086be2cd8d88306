"""A signal raises an exception that ends the command, wherever Python is at that moment."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.cause import is_signal
from tests.pipeline.run.test_signals import SIGNALS, no_signal_ignored

IN_A_CLASS = """
import os, signal, sys
from pipeline import signals

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what starts the tests may ignore it, as nohup does

class Field:
    def __set_name__(self, *_):
        os.kill(os.getpid(), signal.SIGNAL)

try:
    with signals.raising():
        class Owner:
            field = Field()
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_a_class_is_made_is_no_error(number: signal.Signals) -> None:
    text = IN_A_CLASS.replace("SIGNAL", number.name)

    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)

    assert (ended.returncode, ended.stderr) == (128 + number, b"")


IN_A_MODULE = """
import os, signal, sys
from pathlib import Path
from pipeline import signals
from pipeline.errors import SettingsError
from pipeline.import_path import imported

signal.signal(signal.SIGHUP, signal.SIG_DFL)
sys.path.insert(0, FOLDER)
try:
    with signals.raising():
        imported("in_c:Class", SettingsError)
except KeyboardInterrupt:
    sys.exit(130)
"""
# as a module in C does whose own imports a signal interrupts
IN_C = """
import os, signal
try:
    os.kill(os.getpid(), signal.SIGNAL)
except BaseException:
    raise ImportError("initialization failed") from None
"""


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_in_the_import_of_a_module_in_c_is_no_error(
    number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "in_c.py").write_text(IN_C.replace("SIGNAL", number.name))
    text = IN_A_MODULE.replace("FOLDER", repr(str(tmp_path)))

    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)

    assert (ended.returncode, ended.stderr) == (128 + number, b"")


DROPPED = """
import os, signal, sys, time, weakref
from pipeline import signals

signal.signal(signal.SIGHUP, signal.SIG_DFL)

class Watched:
    pass

class Dying:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGNAL)

class Field:
    def __set_name__(self, *_):
        os.kill(os.getpid(), signal.SIGNAL)

class MakingAClass:
    def __del__(self):
        class Owner:
            field = Field()

try:
    with signals.raising():
        ITS_END
        for _ in range(2000):
            time.sleep(0.01)
except KeyboardInterrupt:
    sys.exit(130)
"""
ENDS = {
    "a weak reference": """watched = Watched()
        kept = weakref.ref(watched, lambda _: os.kill(os.getpid(), signal.SIGNAL))
        del watched""",
    "a finalizer": "Dying()",
    "a class in a finalizer": "MakingAClass()",
}


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("its_end", ENDS.values(), ids=ENDS)
def test_a_signal_whose_exception_python_drops_ends_the_process(
    its_end: str, number: signal.Signals
) -> None:
    text = DROPPED.replace("ITS_END", its_end).replace("SIGNAL", number.name)

    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)

    assert (ended.returncode, ended.stderr) == (128 + number, b"")


IN_A_TEXT = """
import os, signal, sys
from pipeline import signals

try:
    with signals.raising():
        exec("os.kill(os.getpid(), signal.SIGINT)")
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_ctrl_c_while_a_text_is_executed_keeps_the_exit_status(tmp_path: Path) -> None:
    (tmp_path / "executing.py").write_text(IN_A_TEXT)
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])

    with no_signal_ignored():
        ended = subprocess.run(
            [sys.executable, "-m", "executing"], env={**os.environ, "PYTHONPATH": paths},
            capture_output=True, check=False,
        )  # fmt: skip

    assert (ended.returncode, ended.stderr) == (130, b"")


IN_DECLARATIONS = """
import os, signal, sys
from pipeline import signals
from pipeline.declarations import check_declarations
from tests.samples import Pass

class Field:
    def __set_name__(self, *_):
        os.kill(os.getpid(), signal.SIGNAL)

class Live:
    def __get__(self, *_):
        class Owner:
            field = Field()
        return ()

class Own(Pass):
    live = Live()

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what starts the tests may ignore it, as nohup does
try:
    with signals.raising():
        check_declarations(Own)
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_declarations_are_read_is_no_wrong_declaration(
    number: signal.Signals,
) -> None:
    text = IN_DECLARATIONS.replace("SIGNAL", number.name)

    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)

    assert (ended.returncode, ended.stderr) == (128 + number, b"")


IN_SETTINGS = """
import os, signal, sys
from dataclasses import dataclass
from pipeline import Operator, signals
from pipeline.declarations import check_declarations
from pipeline.settings import build

class Field:
    def __set_name__(self, *_):
        os.kill(os.getpid(), signal.SIGNAL)

def make_a_class():
    class Owner:
        field = Field()

class Text:
    @classmethod
    def __get_pydantic_core_schema__(cls, _source, handler):
        if "WHEN" == "checked":
            make_a_class()
        return handler(str)

@dataclass(frozen=True)
class Settings:
    text: Text = ""

    def __post_init__(self):
        make_a_class()

class Own(Operator[Settings, None]): ...

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what starts the tests may ignore it, as nohup does
try:
    with signals.raising():
        check_declarations(Own)
        build(Settings, {}, "own")
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("when", ["checked", "built"])
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_settings_are_read_is_no_wrong_setting(
    number: signal.Signals, when: str
) -> None:
    text = IN_SETTINGS.replace("SIGNAL", number.name).replace("WHEN", when)

    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)

    assert (ended.returncode, ended.stderr) == (128 + number, b"")


def test_an_error_that_is_its_own_cause_is_no_signal() -> None:
    error = RuntimeError("no")
    error.__cause__ = error

    assert not is_signal(error)
