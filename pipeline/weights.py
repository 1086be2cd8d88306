"""Third-party networks by name: manifest -> verified files in the weights folder.

A file counts only with the sha256 its manifest entry states; it is fetched when asked for, from a
mirror folder or from its address, and appears in the weights folder complete or not at all.
"""

import hashlib
import http.client
import os
import tempfile
import tomllib
import urllib.request
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from pipeline.errors import SettingsError, WeightsError
from pipeline.settings import build, suggest

MANIFEST = Path(__file__).resolve().parent.parent / "operators" / "weights.toml"  # data, no import
CHUNK_BYTES = 1 << 16
TIMEOUT_S = 30.0

Report = Callable[[int], None]  # called with the number of bytes that came


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What the manifest says of one file."""

    file: str
    url: str  # empty: only to be had from a mirror
    sha256: str
    size_bytes: int
    licence: str
    note: str = ""

    def __post_init__(self) -> None:
        if not self.file or Path(self.file).name != self.file:
            raise SettingsError(f"file: must be a plain file name, got {self.file!r}")
        if self.url and not self.url.startswith(("https://", "http://")):
            raise SettingsError(f"url: must be http(s) or empty, got {self.url!r}")
        if len(self.sha256) != 64 or set(self.sha256) - set("0123456789abcdef"):
            raise SettingsError(f"sha256: must be 64 lower-case hex digits, got {self.sha256!r}")
        if self.size_bytes < 1:
            raise SettingsError(f"size_bytes: must be at least 1, got {self.size_bytes}")


def default_folder() -> Path:
    """Where weights lie unless a folder is given."""
    return Path.home() / ".cache" / "fovea" / "weights"


def read_manifest(path: Path = MANIFEST) -> dict[str, Entry]:
    """Name -> entry; raises `WeightsError` for a file that is absent or not a manifest."""
    try:
        tables = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise WeightsError(f"{path}: no manifest of weights: {error}") from error
    entries = {}
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise WeightsError(f"{path}: {name}: expected a table, got {table!r}")
        try:
            entries[name] = build(Entry, table, name)
        except SettingsError as error:
            raise WeightsError(f"{path}: {error}") from error
    return entries


def find(name: str, folder: Path | None = None, *, manifest: Path = MANIFEST) -> Path | None:
    """The verified file, or None when it was never pulled.

    Raises `WeightsError` for an unknown name and for a file that is not the one named.
    """
    entry = _entry(name, read_manifest(manifest))
    path = (folder or default_folder()) / entry.file
    if not path.is_file():
        return None
    if (got := _sha256(path)) != entry.sha256:
        raise WeightsError(f"{path}: {_differs(entry, got)}; try `fovea weights pull {name}`")
    return path


def require(name: str, folder: Path | None = None, *, manifest: Path = MANIFEST) -> Path:
    """The verified file; raises `WeightsError` when it was never pulled or is not the one named."""
    path = find(name, folder, manifest=manifest)
    if path is None:
        where = folder or default_folder()
        raise WeightsError(f"{where}: no weights {name!r}; try `fovea weights pull {name}`")
    return path


def pull(
    names: Iterable[str],
    mirror: Path | None = None,
    folder: Path | None = None,
    *,
    manifest: Path = MANIFEST,
    timeout_s: float = TIMEOUT_S,
    progress: Progress | None = None,
) -> list[Path]:
    """Fetch what is not there yet, from `mirror` (any sub-folder) or else from the address.

    Raises `WeightsError` for the first that cannot be had; the folder then holds what it held.
    `timeout_s` is how long a server may be silent.
    """
    entries = read_manifest(manifest)
    into = folder or default_folder()
    return [
        _pull_one(name, _entry(name, entries), mirror, into, timeout_s, progress) for name in names
    ]


def _pull_one(
    name: str, entry: Entry, mirror: Path | None, folder: Path, timeout_s: float,
    progress: Progress | None,
) -> Path:  # fmt: skip
    target = folder / entry.file
    if target.is_file() and _sha256(target) == entry.sha256:
        return target
    if mirror is None and not entry.url:
        raise WeightsError(f"{name}: has no address, needs `--mirror` with a {entry.file}")
    task = progress.add_task(name, total=entry.size_bytes) if progress else None

    def report(nbytes: int) -> None:
        if progress and task is not None:
            progress.advance(task, nbytes)

    if mirror is not None:
        source = _in_mirror(entry, mirror)
        with source.open("rb") as stream:
            return _receive(stream, entry, str(source), target, report)
    try:
        with urllib.request.urlopen(entry.url, timeout=timeout_s) as stream:
            return _receive(stream, entry, entry.url, target, report)
    except (OSError, http.client.HTTPException) as error:
        raise WeightsError(f"{entry.url}: not to be had: {error}") from error


def _in_mirror(entry: Entry, mirror: Path) -> Path:
    """The file of that name and sum; of several of the name, the right one."""
    named = sorted(p for p in mirror.rglob(entry.file) if p.is_file())
    for path in named:
        if _sha256(path) == entry.sha256:
            return path
    if named:
        raise WeightsError(f"{named[0]}: {_differs(entry, _sha256(named[0]))}")
    raise WeightsError(f"{mirror}: expected a file {entry.file} there or below, got none")


def _receive(stream: BinaryIO, entry: Entry, source: str, target: Path, report: Report) -> Path:
    """Stream into a file beside `target`, check it, move it there; leave nothing else behind."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f"{target.name}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise WeightsError(f"{target.parent}: cannot be written: {error.strerror}") from error
    try:
        with os.fdopen(handle, "wb") as file:
            _copy_checked(stream, file, entry, source, report)
        Path(name).replace(target)
    finally:
        with suppress(FileNotFoundError):
            Path(name).unlink()
    return target


def _copy_checked(
    stream: BinaryIO, file: BinaryIO, entry: Entry, source: str, report: Report
) -> None:
    digest, count = hashlib.sha256(), 0
    while chunk := stream.read(CHUNK_BYTES):
        count += len(chunk)
        if count > entry.size_bytes:
            raise WeightsError(f"{source}: expected {entry.size_bytes} bytes, got more")
        digest.update(chunk)
        file.write(chunk)
        report(len(chunk))
    if count < entry.size_bytes:
        raise WeightsError(f"{source}: expected {entry.size_bytes} bytes, got {count}")
    if digest.hexdigest() != entry.sha256:
        raise WeightsError(f"{source}: {_differs(entry, digest.hexdigest())}")


def _entry(name: str, entries: dict[str, Entry]) -> Entry:
    if name not in entries:
        raise WeightsError(f"{name}: no such weights{suggest(name, entries)}")
    return entries[name]


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read: {error.strerror}") from error


def _differs(entry: Entry, got: str) -> str:
    return f"expected sha256 {entry.sha256[:12]}…, got {got[:12]}…"


FOLDER = click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), help="Where weights lie."
)


@click.group("weights")
def weights_commands() -> None:
    """Networks made by others: list them, pull them."""


@weights_commands.command("pull")
@click.argument("names", nargs=-1)
@click.option(
    "--mirror",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Copy from this folder (searched by file name) instead of downloading.",
)
@FOLDER
def pull_command(names: tuple[str, ...], mirror: Path | None, folder: Path | None) -> None:
    """Fetch weights by name; without a name, all that can be had."""
    entries = read_manifest()
    if not names:
        names = tuple(n for n, entry in entries.items() if mirror or entry.url)
    with Progress(transient=True) as progress:
        paths = pull(names, mirror, folder, progress=progress)
    for name, path in zip(names, paths, strict=True):
        click.echo(f"{name}: {path} ({entries[name].licence})")
    if not mirror and (rest := [n for n in entries if n not in names and not entries[n].url]):
        click.echo(f"without an address, only from a mirror: {', '.join(rest)}")


@weights_commands.command("list")
@FOLDER
def list_command(folder: Path | None) -> None:
    """Show what there is, its licence, and what has been pulled."""
    table = Table("name", "MB", "licence", "here", "what", title=str(folder or default_folder()))
    for name, entry in read_manifest().items():
        path = (folder or default_folder()) / entry.file
        state = (
            "no" if not path.is_file() else "yes" if _sha256(path) == entry.sha256 else "damaged"
        )
        table.add_row(name, f"{entry.size_bytes / 1e6:.1f}", entry.licence, state, entry.note)
    Console().print(table)
