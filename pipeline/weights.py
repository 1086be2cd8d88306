"""Third-party weights: a name -> the path of a file with a verified checksum.

The manifest `operators/weights.toml` describes each file and its origin. Files are downloaded only
by `fovea weights pull`, and used only if their sha256 matches the manifest.
"""

import difflib
import hashlib
import http.client
import json
import re
import tomllib
import urllib.request
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import IO, Any

import click
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from rich.table import Table

from pipeline import terminal
from pipeline.errors import WeightsError
from pipeline.whole_file import whole_file

MANIFEST = Path(__file__).resolve().parents[1] / "operators" / "weights.toml"
CHUNK_BYTES = 1 << 16

Advance = Callable[[int], None]  # called with the number of bytes copied since


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One file of the manifest. Without `url` it can only come from a mirror."""

    name: str
    file: str
    url: str
    size_bytes: int
    sha256: str
    licence: str
    note: str

    def __post_init__(self) -> None:
        if Path(self.file).name != self.file:
            raise WeightsError(f"{self.name}.file: expected a bare file name, got {self.file!r}")
        if self.url and not self.url.startswith(("https://", "http://")):
            raise WeightsError(f"{self.name}.url: expected https://… or nothing, got {self.url!r}")
        if self.size_bytes < 1:
            raise WeightsError(f"{self.name}.size_bytes: must be at least 1, got {self.size_bytes}")
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise WeightsError(f"{self.name}.sha256: expected 64 hex digits, got {self.sha256!r}")


def entries(manifest: Path = MANIFEST) -> dict[str, Entry]:
    """Return all entries of a manifest by name; raises `WeightsError` for an invalid manifest."""
    try:
        tables = tomllib.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise WeightsError(f"{manifest}: not a manifest of weights: {error}") from error
    try:
        return {name: _entry(name, table) for name, table in tables.items()}
    except WeightsError as error:
        raise WeightsError(f"{manifest}: {error}") from error


def default_folder() -> Path:
    """Return the default folder of pulled weights."""
    return Path.home() / ".cache" / "fovea" / "weights"


def find(name: str, folder: Path | None = None, *, manifest: Path = MANIFEST) -> Path | None:
    """Return the path of the pulled copy of `name`; None when it is missing or damaged.

    Raises `WeightsError` for a name that is not in the manifest.
    """
    entry = _named(name, manifest)
    path = (folder or default_folder()) / entry.file
    return path if path.is_file() and matches(path, entry) else None


def require(name: str, folder: Path | None = None, *, manifest: Path = MANIFEST) -> Path:
    """Like `find`, but raise `WeightsError` with a hint when there is no intact copy."""
    path = find(name, folder, manifest=manifest)
    if path is None:
        raise WeightsError(
            f"{name}: expected {_named(name, manifest).file} in {folder or default_folder()}, "
            f"got none that is intact; run `fovea weights pull {name}`"
        )
    return path


def weights_file(weights: str, shipped: Mapping[str, Path]) -> Path:
    """Return the file of a setting: a shipped one by name, a path (`….onnx`) or from weights.toml.

    The shipped one of the name "" is the usual one. Raises `WeightsError` for an unknown name, for
    one without an intact copy, and for a file of another kind.
    """
    if weights in shipped:
        return shipped[weights]
    if weights.endswith(".onnx"):
        return Path(weights)
    if "/" in weights or Path(weights).suffix:
        what = "an ONNX file, ending in .onnx, or a name that `fovea weights list` shows"
        raise WeightsError(f"{weights}: expected {what}")
    known = entries()
    if weights not in known:
        raise WeightsError(f"{weights}: no such weights; {_hint(weights, [*shipped, *known])}")
    return require(weights)


def pull_hint(path: Path, *, manifest: Path = MANIFEST) -> str:
    """Return a hint how to get a missing file; empty when the manifest does not list it."""
    named = [name for name, entry in entries(manifest).items() if entry.file == path.name]
    return f"; `fovea weights pull {named[0]}` fetches it" if named else ""


def pull(
    names: Iterable[str],
    mirror: Path | None = None,
    folder: Path | None = None,
    *,
    manifest: Path = MANIFEST,
    timeout_s: float = 30.0,
    progress: Progress | None = None,
) -> list[Path]:
    """Copy weights into the folder, from a mirror folder or else from their URL.

    Intact copies stay as they are. Raises `WeightsError` when a file is unavailable or does not
    match the manifest; then no part of it is left behind, and earlier files stay.
    """
    wanted = [_named(name, manifest) for name in names]
    folder = folder or default_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WeightsError(f"{folder}: cannot keep weights there: {error}") from error
    return [_pull_one(entry, mirror, folder, timeout_s, progress) for entry in wanted]


def matches(path: Path, entry: Entry) -> bool:
    """Whether a file's size and sha256 match the manifest."""
    if path.stat().st_size != entry.size_bytes:
        return False
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() == entry.sha256


def _entry(name: str, table: Any) -> Entry:
    kinds = {f.name: f.type for f in fields(Entry) if f.name != "name"}
    if not isinstance(table, dict) or set(table) != set(kinds):
        got = sorted(table) if isinstance(table, dict) else table
        raise WeightsError(f"{name}: expected the fields {', '.join(kinds)}, got {got}")
    for field, kind in kinds.items():
        if type(table[field]) is not kind:
            word = "a whole number" if kind is int else "a text"
            raise WeightsError(f"{name}.{field}: expected {word}, got {table[field]!r}")
    return Entry(name=name, **table)


def _named(name: str, manifest: Path) -> Entry:
    known = entries(manifest)
    if name not in known:
        raise WeightsError(f"{name}: no such weights in {manifest.name}; {_hint(name, known)}")
    return known[name]


def _hint(name: str, known: Iterable[str]) -> str:
    names = [other for other in known if other]
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(names)}"


def _pull_one(
    entry: Entry, mirror: Path | None, folder: Path, timeout_s: float, progress: Progress | None
) -> Path:
    target = folder / entry.file
    if target.is_file() and matches(target, entry):
        return target
    advance = _advance(entry, progress)
    opened = _mirrored(entry, mirror) if mirror else _addressed(entry, timeout_s)
    try:
        with opened as (source, origin):
            _take(source, origin, target, entry, advance)
    except (OSError, http.client.HTTPException) as error:  # the server refuses, the disk is full
        raise WeightsError(f"{entry.name}: {mirror or entry.url}: {error}") from error
    return target


@contextmanager
def _mirrored(entry: Entry, mirror: Path) -> Iterator[tuple[IO[bytes], str]]:
    found = sorted(path for path in mirror.rglob(entry.file) if path.is_file())
    if not found:
        raise WeightsError(f"{entry.name}: expected {entry.file} somewhere in {mirror}, got none")
    # a mirror may hold several files of that name: prefer the one that matches
    path = next((path for path in found if matches(path, entry)), found[0])
    with path.open("rb") as file:
        yield file, str(path)


@contextmanager
def _addressed(entry: Entry, timeout_s: float) -> Iterator[tuple[IO[bytes], str]]:
    if not entry.url:
        raise WeightsError(f"{entry.name}: has no address; give a folder that has {entry.file}")
    with urllib.request.urlopen(entry.url, timeout=timeout_s) as response:
        yield response, entry.url


def _take(source: IO[bytes], origin: str, target: Path, entry: Entry, advance: Advance) -> None:
    """Copy, verify, then rename, so that the target is complete and correct or absent."""
    with whole_file(target) as file:
        size_bytes, sha256 = _copy(source, file, entry.size_bytes, advance)
        if size_bytes != entry.size_bytes:
            got = f"more than {entry.size_bytes}" if size_bytes > entry.size_bytes else size_bytes
            raise WeightsError(
                f"{entry.name}: {origin}: expected {entry.size_bytes} bytes, got {got}"
            )
        if sha256 != entry.sha256:
            raise WeightsError(
                f"{entry.name}: {origin}: expected sha256 {entry.sha256}, got {sha256}"
            )


def _copy(
    source: IO[bytes], file: IO[bytes], limit_bytes: int, advance: Advance
) -> tuple[int, str]:
    """Copy, and return size in bytes and sha256; stop soon after the limit is exceeded."""
    digest, size_bytes = hashlib.sha256(), 0
    while size_bytes <= limit_bytes and (chunk := source.read(CHUNK_BYTES)):
        file.write(chunk)
        digest.update(chunk)
        size_bytes += len(chunk)
        advance(len(chunk))
    return size_bytes, digest.hexdigest()


def _advance(entry: Entry, progress: Progress | None) -> Advance:
    if progress is None:
        return lambda _bytes: None
    task = progress.add_task(entry.name, total=entry.size_bytes)
    return lambda more_bytes: progress.advance(task, more_bytes)


@click.group("weights")
def weights_commands() -> None:
    """List and download third-party networks."""


@weights_commands.command("pull")
@click.argument("names", nargs=-1)
@click.option(
    "--mirror",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Copy from this folder instead of downloading.",
)
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), help="Keep them here.")
def pull_command(names: tuple[str, ...], mirror: Path | None, folder: Path | None) -> None:
    """Download NAMES, or all that are available, and verify each."""
    wanted = names or tuple(n for n, entry in entries().items() if mirror or entry.url)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    console = terminal.console(stderr=True)
    with Progress(*columns, TransferSpeedColumn(), console=console) as progress:
        paths = pull(wanted, mirror, folder, progress=progress)
    for path in paths:
        click.echo(path)


@weights_commands.command("list")
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), help="Look here.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def list_command(folder: Path | None, as_json: bool) -> None:
    """List the networks of the manifest and which of them are present."""
    found = [(entry, find(name, folder)) for name, entry in entries().items()]
    if as_json:
        told = [{**asdict(entry), "path": str(path) if path else None} for entry, path in found]
        click.echo(json.dumps({"weights": told}, indent=1))
        return
    table = Table("name", "here", "kB", "licence", "note", box=None)
    for entry, path in found:
        here = "yes" if path else "no"
        table.add_row(entry.name, here, f"{entry.size_bytes / 1e3:.0f}", entry.licence, entry.note)
    terminal.console().print(table)
