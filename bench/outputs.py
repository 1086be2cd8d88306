"""Files that an evaluation writes: paths in; before any work, a sentence for one that cannot be."""

import os
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import SettingsError
from pipeline.extras import need
from pipeline.whole_file import write_whole

if TYPE_CHECKING:  # an extra installs it
    from matplotlib.figure import Figure

PLOTS = (".png", ".pdf", ".svg")
STANDARD_OUTPUT = Path("-")


def work_folder(work: Path | None, report: Path | None, default: str) -> Path:
    """Return the folder for what is finished: as given, beside the report, or a name.

    Raises `SettingsError` for a report without a name.
    """
    if report is not None and not report.name:
        raise SettingsError(f"report: expected a file, got {report}")
    return work or (report.with_suffix(".work") if report else Path(default))


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
        if path is None or (name, path) == ("markdown", STANDARD_OUTPUT):
            continue
        if path == STANDARD_OUTPUT:
            raise SettingsError(f"{name}: expected a file, got {path}; --markdown - prints")
        make_folder(name, path.parent)
        special = path.exists() and not path.is_file()
        if special or (path.exists() and not os.access(path, os.W_OK)):
            raise SettingsError(f"{name}: expected a file that can be written, got {path}")


def write_figure(figure: "Figure", path: Path, dpi: int = 140) -> None:
    """Write a picture in the format of its suffix, whole; raises `OSError` with the file."""
    drawn = BytesIO()
    figure.savefig(drawn, format=path.suffix.removeprefix("."), dpi=dpi)
    write_whole(path, drawn.getbuffer())


def make_folder(name: str, folder: Path) -> None:
    """Make a folder if there is none; raises `SettingsError` if it cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{name}: {folder}: cannot be a folder: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise SettingsError(f"{name}: {folder}: cannot be written to")
