"""One line of a diagnosis."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was looked at, how it is, and what to do when it is not well."""

    what: str
    verdict: Verdict
    why: str
    todo: str = ""


def ok(what: str, why: str) -> Finding:
    """All is well."""
    return Finding(what=what, verdict="ok", why=why)


def warning(what: str, why: str, todo: str) -> Finding:
    """It runs, but not as well as it could, or not always."""
    return Finding(what=what, verdict="warning", why=why, todo=todo)


def wrong(what: str, why: str, todo: str) -> Finding:
    """It will not run."""
    return Finding(what=what, verdict="wrong", why=why, todo=todo)
