"""The files of the code that a process has imported, installed packages left out."""

import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator

INSTALLED = tuple(
    os.path.join(sysconfig.get_path(kind), "")
    for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)


def module_files() -> Iterator[str]:
    """Yield the files of all modules of this process that are no part of an installed package."""
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if isinstance(file, str) and file and not file.startswith(INSTALLED):
            yield file


def edited_since(moment_s: float, files: Iterable[str]) -> bool:
    """Whether one of the files was edited since; `moment_s` is a time of `time.time()`."""
    for file in files:
        try:
            if os.stat(file).st_mtime > moment_s:  # a Path would intern each part of it
                return True
        except (OSError, ValueError):
            continue
    return False
