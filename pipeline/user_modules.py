"""Modules of the user: found in the current folder, behind those of Python and of fovea itself.

A `queue.py` in that folder must not take the place of Python's, nor a `pipeline.py` that of fovea.
"""

import contextlib
import importlib
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]  # the folder with fovea's packages
PACKAGES = ("drivers", "operators", "bench")  # of fovea, beside this one


def interpreter_options() -> list[str]:
    """Return options for an interpreter that finds fovea before what lies in the current folder."""
    return [] if current_folder() == str(ROOT) else ["-P"]


def current_folder() -> str:
    """Return the current folder; a word in place of one that was removed meanwhile."""
    try:
        return os.getcwd()
    except OSError:
        return "a folder that was removed"


def look_in(folder: str = "") -> None:
    """Let modules of a folder be imported; empty: of whatever is the current one."""
    for package in PACKAGES:
        with contextlib.suppress(ImportError):
            importlib.import_module(package)
    if folder not in sys.path:
        sys.path.insert(_behind_python(), folder)


def _behind_python() -> int:
    library = os.path.dirname(os.__file__)
    own = {library, os.path.join(library, "lib-dynload")}
    return max((place for place, path in enumerate(sys.path) if path in own), default=-1) + 1


def advice(module: str) -> str:
    """Say why a module of the current folder may not be the one that was imported, or nothing."""
    top = module.partition(".")[0]
    here, inside = Path(f"{top}.py"), Path(top, f"{top}.py")
    loaded = getattr(sys.modules.get(top), "__file__", None)
    if here.is_file() and loaded and here.resolve() != Path(loaded).resolve():
        return f"; {here} has the name of another module: rename it"
    if inside.is_file() and not loaded:
        return f"; {inside} is found from the folder {top}: start fovea there"
    return ""
