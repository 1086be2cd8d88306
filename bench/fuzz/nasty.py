"""Problematic values, names and texts, and mutation of valid documents."""

import copy
import json
import random
from typing import Any

NAMES = (
    "", ".", "..", "/etc/passwd", "../../x", "a/b", "**", "*", "$x", "#", "a?b", "a b", "-a", "@a",
    "a\0b", "a\nb", "ä", "名", "x" * 33, "x" * 5000, "null", "true", "1", "work", "__class__",
    "a.b", "a:b", "=", "\u202e", "~", "\x7f",
)  # fmt: skip
TEXTS = (
    *NAMES, "os:system", "json:dumps", "no.such.module:Class", "operators.dispatch:Dispatch", ":",
    "a:", ":b", "operators.capture:Nothing", "..x:Y", "yes", "no", "1e400", "never", "latest",
    "capture.context", "capture.", ".context", "capture.context.x", "{", "%s%n", "{0}", "sha256:0",
)  # fmt: skip
NUMBERS = (
    0, -1, 1, 65, 2**31, 2**63, 2**64, -(2**63) - 1, 10**30, 10**400, 0.5, -0.0, 1e-320, 1e308, 1.5,
)  # fmt: skip
RAW = (  # YAML that JSON cannot write
    ".inf", "-.INF", ".nan", "1e999", "0x" + "f" * 40, "1_000", "9" * 5000, "0o17", "2001-01-01",
    "!!python/object/apply:os.system [id]", "!!binary aGk=", "!!timestamp 2001-01-01", "!x y", "*a",
    "&a [*a]", "&a {b: *a}", "<<", "{<<: *b}", "{<<: [1]}", "? [1]", "[" * 3000, "{a: " * 3000,
    "|\n  text\n", '"\\ud800"', '"\\x00"', '"\\UFFFFFFFF"', "'", '"', "@", "`", "%", "- - - -",
    "~", "---\na: 1", "...", "\t", "{1: 2}", "{[1]: 2}", "{a: 1, a: 2}", "\ufeff", "{? : }", "!",
)  # fmt: skip


class Raw(str):
    """Text in a document that is written into the file verbatim."""

    __slots__ = ()


def value(rng: random.Random, depth: int = 0) -> Any:
    """Return a random value that is hardly ever valid."""
    kind = rng.randrange(7 if depth < 3 else 4)
    if kind == 0:
        return rng.choice(TEXTS)
    if kind == 1:
        return rng.choice(NUMBERS)
    if kind == 2:
        return rng.choice((None, True, False))
    if kind == 3:
        return Raw(rng.choice(RAW))
    if kind == 4:
        return [value(rng, depth + 1) for _ in range(rng.randrange(4))]
    if kind == 5:
        return {rng.choice(NAMES): value(rng, depth + 1) for _ in range(rng.randrange(4))}
    nested: Any = value(rng, 3)
    for _ in range(rng.choice((5, 40, 100))):
        nested = [nested] if rng.random() < 0.5 else {"a": nested}
    return nested


def spoilt(document: Any, rng: random.Random, changes: int) -> Any:
    """Return a copy of a document of mappings and lists with some of its keys or values changed."""
    document = copy.deepcopy(document)
    for _ in range(changes):
        places = list(_places(document))
        if not places:
            return value(rng)
        parent, key = rng.choice(places)
        kind = rng.randrange(6)
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, dict):
            parent[rng.choice(NAMES)] = parent.pop(key)
        elif kind == 2:
            _, other = rng.choice(places)
            parent[key] = copy.deepcopy(rng.choice(places)[0]) if rng.random() < 0.3 else other
        elif kind == 3 and isinstance(parent, dict):
            parent[rng.choice((*NAMES, "name", "nodes", "inputs", "settings", "from"))] = value(rng)
        else:
            parent[key] = value(rng)
    return document


def flipped(data: bytes, rng: random.Random) -> bytes:
    """Return the data with some bytes changed, removed, repeated or inserted."""
    work = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(work) + 1)
        kind = rng.randrange(5)
        if kind == 0 and at < len(work):
            work[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(work):
            work[at] = rng.choice((0, 1, 0x7F, 0x80, 0xC0, 0xC1, 0xDD, 0xDF, 0xFF))
        elif kind == 2:
            del work[at : at + rng.choice((1, 2, 8, 64, 10_000))]
        elif kind == 3:
            work[at:at] = work[at : at + rng.choice((1, 4, 32))]
        else:
            work[at:at] = rng.randbytes(rng.choice((1, 2, 5, 9)))
    return bytes(work)


def written(document: Any) -> str:
    """Return a document as YAML in flow style, with its `Raw` texts verbatim."""
    if isinstance(document, Raw):
        return str(document)
    if isinstance(document, dict):
        items = (f"{json.dumps(str(k))}: {written(v)}" for k, v in document.items())
        return "{" + ",\n ".join(items) + "}"
    if isinstance(document, list):
        return "[" + ", ".join(written(v) for v in document) + "]"
    if isinstance(document, int) and not isinstance(document, bool):
        return str(document)
    return json.dumps(document)


def _places(document: Any) -> Any:
    if isinstance(document, dict):
        for key in document:
            yield document, key
            yield from _places(document[key])
    elif isinstance(document, list):
        for index, item in enumerate(document):
            yield document, index
            yield from _places(item)
