"""A finding: one line of a diagnosis."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """The subject of a check, its verdict and, if not ok, a remedy."""

    what: str
    verdict: Verdict
    why: str
    todo: str = ""


def ok(what: str, why: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(what=what, verdict="ok", why=why)


def warning(what: str, why: str, todo: str) -> Finding:
    """Return a finding that degrades graphs, or stops them at times."""
    return Finding(what=what, verdict="warning", why=why, todo=todo)


def wrong(what: str, why: str, todo: str) -> Finding:
    """Return a finding that prevents graphs from running."""
    return Finding(what=what, verdict="wrong", why=why, todo=todo)
