"""Source files of the modules that a process has imported, without installed packages."""

import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator

INSTALLED = tuple(
    os.path.join(sysconfig.get_path(kind), "")
    for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)


def module_files() -> Iterator[str]:
    """Yield the files of this process's modules, except those of installed packages."""
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if isinstance(file, str) and file and not file.startswith(INSTALLED):
            yield file


def edited_since(moment_s: float, files: Iterable[str]) -> bool:
    """Whether one of the files was edited after `moment_s`, in seconds as of `time.time()`."""
    for file in files:
        try:
            if os.stat(file).st_mtime > moment_s:  # pathlib would intern each part of the path
                return True
        except (OSError, ValueError):
            continue
    return False
