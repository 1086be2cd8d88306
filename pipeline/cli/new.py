"""`fovea new operator|driver|task NAME`: a folder with code, test, graph and README that runs.

The files are templates in `templates/KIND`, in which only `$name` and `$Class` are replaced.
"""

import builtins
import contextlib
import keyword
import os
import re
import sys
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from string import Template

import click

from pipeline.errors import SettingsError
from pipeline.naming import LONGEST_NAME
from pipeline.wording import shown

TEMPLATES = Path(__file__).parent / "templates"
KINDS = ("operator", "driver", "task")
SUFFIX = ".txt"  # of a template, which is neither Python nor a page before its name is filled in
CODE = (".py", ".yaml")
_NAME = re.compile(rf"[a-z][a-z0-9_]{{0,{LONGEST_NAME - 1}}}")
_WORD = re.compile(r"\w+")


def class_name(name: str) -> str:
    """Return the name of the class in a module.

    >>> class_name("blue_sky2")
    'BlueSky2'
    """
    return "".join(word.capitalize() for word in name.split("_"))


def check_new_name(kind: str, name: str) -> str:
    """Return the name if it can be a module's and collides with none; raises `SettingsError`."""
    if _NAME.fullmatch(name) is None:
        raise SettingsError(
            f"new {kind}: expected a name of up to {LONGEST_NAME} lower-case letters, digits and _ "
            f"that begins with a letter, got {shown(name)}"
        )
    if name.startswith("test"):  # pytest would take the module or its class for a test
        raise SettingsError(
            f"new {kind}: expected a name that does not begin with test, got {name}"
        )
    if keyword.iskeyword(name) or {name, class_name(name)} & (_used_by(kind) | set(dir(builtins))):
        raise SettingsError(f"new {kind}: {name} is used by Python or by the code; choose another")
    elsewhere = [folder for folder in sys.path if folder not in ("", os.getcwd())]
    if name in sys.stdlib_module_names or PathFinder.find_spec(name, elsewhere) is not None:
        raise SettingsError(f"new {kind}: there is already a module {name}; choose another name")
    return name


def create(kind: str, name: str, parent: Path) -> list[Path]:
    """Write the files of a kind into the new folder `parent / name` and return their paths.

    Raises `SettingsError` for a name that cannot be used or exists there, and `OSError` when they
    cannot be written; then nothing remains.
    """
    folder = parent / check_new_name(kind, name)
    try:
        folder.mkdir()  # fails for anything that exists, links included
    except FileExistsError as error:
        raise SettingsError(f"new {kind}: {folder} exists; nothing was written") from error
    written: list[Path] = []
    try:
        for template in sorted((TEMPLATES / kind).glob(f"*{SUFFIX}")):
            path = folder / template.name.removesuffix(SUFFIX).replace("NAME", name)
            written.append(path)
            path.write_text(filled(template, name), encoding="utf-8")
    except BaseException:
        with contextlib.suppress(OSError):
            for path in written:
                path.unlink(missing_ok=True)
            folder.rmdir()
        raise
    return written


def filled(template: Path, name: str) -> str:
    """Return the text of a template for a name."""
    text = Template(template.read_text(encoding="utf-8"))
    return text.substitute(name=name, Class=class_name(name))


@cache
def _used_by(kind: str) -> set[str]:
    """Return the words of the code and graph of a kind: a name among them would hide one."""
    words = {"conftest"}
    for template in (TEMPLATES / kind).glob(f"*{SUFFIX}"):
        if template.name.removesuffix(SUFFIX).endswith(CODE):
            words |= set(_WORD.findall(template.read_text(encoding="utf-8")))
    return words


@click.command("new")
@click.argument("kind", type=click.Choice(KINDS))
@click.argument("name")
def new_command(kind: str, name: str) -> None:
    """Create a folder NAME for a new operator, driver or task: code, test, graph, README."""
    for path in create(kind, name, Path()):
        click.echo(path)
    click.echo(f"now: cd {name} && fovea run {name}.yaml --frames 100")
