"""Files that an evaluation writes: paths in; before any work, a sentence for one that cannot be."""

import os
from pathlib import Path

from pipeline.errors import SettingsError
from pipeline.extras import need

PLOTS = (".png", ".pdf", ".svg")
STANDARD_OUTPUT = Path("-")


def make_room(work: Path, *, plot: Path | None = None, **tables: Path | None) -> None:
    """Make the folders of the files, which are named by their options.

    Raises `SettingsError` for one that cannot be written, `InstallError` for a plot by nothing.
    """
    if plot and plot.suffix not in PLOTS:
        raise SettingsError(f"plot: expected {', '.join(PLOTS)} at the end, got {plot}")
    if plot:
        need("matplotlib", "plot")
    make_folder("work", work)
    for name, path in {**tables, "plot": plot}.items():
        if path in (None, STANDARD_OUTPUT):
            continue
        make_folder(name, path.parent)
        special = path.exists() and not path.is_file()
        if special or (path.exists() and not os.access(path, os.W_OK)):
            raise SettingsError(f"{name}: expected a file that can be written, got {path}")


def make_folder(name: str, folder: Path) -> None:
    """Make a folder if there is none; raises `SettingsError` if it cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{name}: {folder}: cannot be a folder: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise SettingsError(f"{name}: {folder}: cannot be written to")
