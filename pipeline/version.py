"""Version of fovea, and the commit it was built from.

A wheel has its commit in `commit.txt`, written by the build; the source tree asks git. Without
either, only the version is known.
"""

import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RECORD = "commit.txt"  # beside this file, in a wheel
SHOWN = 12  # characters of a commit


def described() -> str:
    """Return the version, with the commit where known: `0.2.0 (commit 1e36e692cf0a)`."""
    found = commit()
    return f"{version()} (commit {found})" if found else version()


def version(root: Path = ROOT) -> str:
    """Return the version of the source tree of this file, otherwise of the installed package."""
    try:
        project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        if project["name"] == "fovea":
            return str(project["version"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    try:
        return metadata.version("fovea")
    except metadata.PackageNotFoundError:
        return "unknown"


def commit(root: Path = ROOT) -> str:
    """Return the commit, followed by `+` where tracked files differ; empty if unknown."""
    if (root / ".git").exists():  # a folder, or the file of a worktree
        found, changed = revision(root)
        return f"{found[:SHOWN]}+" if changed else found[:SHOWN]
    try:
        return (root / "pipeline" / RECORD).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def revision(root: Path = ROOT) -> tuple[str, bool]:
    """Return the commit of a folder (empty without git) and whether tracked files differ."""
    found = _git(root, "rev-parse", "HEAD")
    return found, bool(found and _git(root, "status", "--porcelain", "--untracked-files=no"))


def _git(root: Path, *words: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *words], capture_output=True, text=True, check=False
        )
    except OSError:  # there is no git
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
