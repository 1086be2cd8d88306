"""What may run on a host: operators by name and checksum, weights by checksum.

Code and paths never come over the wire: a graph names operators that this host lists, and files
only as `sha256:…` of weights that this host lists too.
"""

import hashlib
import importlib.util
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.bus.network import LARGEST_BYTES
from pipeline.errors import SettingsError, WeightsError
from pipeline.whole_file import write_whole

ANY = "any"  # instead of a checksum: whatever version is installed
DIGEST_PREFIX = "sha256:"
MOST_WEIGHTS_BYTES = LARGEST_BYTES - (1 << 20)  # they travel as one message
DEEPEST = 32  # of a setting's value
_NAME_OF_FILE = re.compile(r".*\.[^\W\d]\w{0,9}", re.DOTALL)  # it ends like one
_DIGEST = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Allowed:
    """The lists of one host."""

    code: Mapping[str, str]  # module:Class -> sha256 of its files, or `any`
    weights: Mapping[str, Path | None]  # sha256 -> file; None: may be sent
    store: Path  # where sent weights are kept

    def check_code(self, path: str, where: str) -> None:
        """Raise `SettingsError` unless that class may be loaded as it is installed here."""
        if path not in self.code:
            raise SettingsError(f"{where}: {path} is not on the allow list of this host")
        wanted = self.code[path]
        if wanted != ANY and (got := code_digest(path)) != wanted:
            raise SettingsError(
                f"{where}: {path}: expected code with sha256 {wanted[:12]}…, got {got[:12]}…"
            )

    def localise(self, value: Any, where: str, depth: int = 0) -> Any:
        """Values of a setting with weights as files of this host; raises for anything forbidden."""
        if depth > DEEPEST:
            raise SettingsError(f"{where[:60]}: expected no more than {DEEPEST} levels")
        if isinstance(value, Mapping):
            return {
                self.localise(k, where, depth + 1): self.localise(v, f"{where}.{k}", depth + 1)
                for k, v in value.items()
            }
        if isinstance(value, (list, tuple)):
            return [self.localise(v, where, depth + 1) for v in value]
        if not isinstance(value, str):
            return value
        if value.startswith(DIGEST_PREFIX):
            return str(self.file(value.removeprefix(DIGEST_PREFIX), where))
        if is_code(value):
            self.check_code(value, where)
        elif is_path(value):
            raise SettingsError(
                f"{where}: expected no path from outside, got {value!r}; set it in the agent's file"
            )
        return value

    def file(self, digest: str, where: str) -> Path:
        """The weights with that checksum; raises `SettingsError` when they are not to be used."""
        if digest not in self.weights:
            raise SettingsError(f"{where}: weights {digest[:12]}… are not on the allow list")
        path = self.weights[digest] or self.store / digest
        if not path.is_file():
            raise SettingsError(f"{where}: weights {digest[:12]}… are allowed, but not there yet")
        if (got := file_digest(path)) != digest:
            raise SettingsError(f"{where}: {path}: expected sha256 {digest[:12]}…, got {got[:12]}…")
        return path

    def missing(self, value: Any) -> tuple[str, ...]:
        """The weights in a setting's values that are allowed and not there."""
        found = strings(value, lambda text: text.startswith(DIGEST_PREFIX))
        digests = {text.removeprefix(DIGEST_PREFIX) for text in found}
        known = {d: self.weights[d] or self.store / d for d in digests if d in self.weights}
        return tuple(sorted(d for d, path in known.items() if not path.is_file()))

    def keep(self, data: bytes) -> str:
        """Store weights that were sent; raises `WeightsError` when nobody wants them here."""
        digest = hashlib.sha256(data).hexdigest()
        if digest not in self.weights or len(data) > MOST_WEIGHTS_BYTES:
            raise WeightsError(f"weights {digest[:12]}… are not on the allow list")
        self.store.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(self.store / digest, data)
        return digest


def is_path(value: str) -> bool:
    """Whether a string is written like the name of a file, there or not.

    >>> [is_path(text) for text in ("ball", "1.5", "look.rrd", "../x", "main referee")]
    [False, False, True, True, False]
    """
    if any(mark in value for mark in "/\\\0") or value.startswith((".", "~")):
        return True
    return bool(_NAME_OF_FILE.fullmatch(value))


def is_code(value: str) -> bool:
    """Whether a string could name something that is loaded; times and the like must do without."""
    return ":" in value and not value.startswith(DIGEST_PREFIX)


def strings(value: Any, wanted: Callable[[str], bool]) -> list[str]:
    """All strings in a value that are wanted."""
    if isinstance(value, Mapping):
        return [s for v in value.values() for s in strings(v, wanted)]
    if isinstance(value, (list, tuple)):
        return [s for v in value for s in strings(v, wanted)]
    return [value] if isinstance(value, str) and wanted(value) else []


def code_of(operator: str, settings: Any) -> list[str]:
    """The classes that a node names: its operator, and whatever its settings name."""
    return [operator, *strings(settings, is_code)]


def code_digest(path: str) -> str:
    """sha256 over the files of a class's module or package; raises `SettingsError`."""
    module = path.partition(":")[0]
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError) as error:
        raise SettingsError(f"{path}: not installed here: {error}") from error
    if spec is None or spec.origin is None:
        raise SettingsError(f"{path}: not installed here")
    origin = Path(spec.origin)
    files = sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.relative_to(origin.parent).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def file_digest(path: Path) -> str:
    """sha256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_digest(text: str) -> bool:
    """Whether it is written as a sha256."""
    return bool(_DIGEST.fullmatch(text))
