"""Rules for this repository that a test can check."""

import ast
import gc
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from pipeline.graph.loader import load

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("pipeline", "operators", "graphs", "drivers", "tests", "bench")
FILES = (
    "pyproject.toml", "README.md", "LICENSE", "Makefile", "SECURITY.md", "CONTRIBUTING.md",
    "CHANGELOG.md", "CITATION.cff",
)  # fmt: skip
LIVE = ("pipeline", "operators", "drivers")
LONGEST_FILE, LONGEST_FUNCTION = 400, 60


def tracked(*suffixes: str) -> list[Path]:
    """Return the files that git tracks or would add; without git, all in the top folders."""
    command = ["git", "ls-files", "-co", "--exclude-standard"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        names = listed.stdout.splitlines()
    except FileNotFoundError:
        names = []
    named = [ROOT / n for n in (*ROOMS, *FILES)]
    paths = [ROOT / n for n in names] or [p for n in named for p in (n, *n.rglob("*"))]
    return [p for p in paths if p.is_file() and p.suffix in suffixes]


SOURCES = tracked(".py")


def trees(*rooms: str) -> Iterator[tuple[Path, ast.Module]]:
    for path in SOURCES:
        if path.relative_to(ROOT).parts[0] in rooms:
            yield path, parsed(path)


@cache
def parsed(path: Path) -> ast.Module:
    """Return the tree of a file, parsed once for all rules."""
    return ast.parse(path.read_text())


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Return the nodes that rules check, cached because walking all trees takes a second."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Import, ast.ImportFrom, ast.Call)
    return tuple(
        node
        for node in ast.walk(parsed(path))
        if isinstance(node, kinds)
        or (isinstance(node, ast.Constant) and isinstance(node.value, str))
    )


@pytest.fixture(scope="module", autouse=True)
def without_collections() -> Iterator[None]:
    """Collect no garbage: the trees are a million objects, which each collection would visit."""
    gc.disable()
    yield
    parsed.cache_clear()
    nodes.cache_clear()
    gc.enable()


def test_the_top_level_is_fixed() -> None:
    listed = {p.relative_to(ROOT).parts[0] for p in tracked(".py", ".md", ".toml", ".yaml", "")}

    assert {n for n in listed if not n.startswith(".")} <= {*ROOMS, *FILES}


def test_no_file_has_a_catch_all_name() -> None:
    drawers = {"utils", "util", "helpers", "common", "misc"}

    assert [p for p in SOURCES if p.stem in drawers or set(p.parts[:-1]) & drawers] == []


def test_no_module_is_named_like_one_of_the_standard_library() -> None:
    assert [p for p in SOURCES if p.stem in sys.stdlib_module_names] == []


def test_files_and_functions_are_short_enough_to_read() -> None:
    long = []
    for path in SOURCES:
        text = path.read_text()
        lines = len(text.splitlines())
        if lines > LONGEST_FILE:
            long.append(f"{path.relative_to(ROOT)}: {lines} lines")
        for node in nodes(path):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > LONGEST_FUNCTION:
                    place = f"{path.relative_to(ROOT)}:{node.lineno}"
                    long.append(f"{place} {node.name}: {length} lines")

    assert long == []


def test_only_tests_of_footage_reach_the_folder_beside_the_repository() -> None:
    folder = re.compile(r"(^|.*/)shared(/.*|$)")
    reaching = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, _ in trees(*ROOMS)
        if path != ROOT / "tests" / "conftest.py"
        for node in nodes(path)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and folder.fullmatch(node.value)
    ]

    assert reaching == []


def test_every_module_has_a_docstring_of_sentences() -> None:
    mute = []
    for path, tree in trees(*ROOMS):
        first = (ast.get_docstring(tree) or "").split("\n")[0]
        if (
            path.stat().st_size
            and not first.endswith((".", "?", ":", ";", ","))
            and not (ast.get_docstring(tree) or "").split("\n\n")[0].endswith((".", ":"))
        ):
            mute.append(path)

    assert mute == []


def test_nothing_is_pickled_or_evaluated() -> None:
    found = []
    for path, _ in trees(*LIVE):
        for node in nodes(path):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = [node.func.id]
            bad = {"pickle", "marshal", "shelve", "dill", "eval", "exec"} & set(names)
            found += [f"{path.name}:{node.lineno} {name}" for name in bad]  # type: ignore[attr-defined]

    assert found == []


def test_environment_variables_configure_nothing() -> None:
    readers = re.compile(r"os\.getenv|os\.environ(\[|\.get)")

    assert [p for p, _ in trees(*LIVE) if readers.search(p.read_text())] == []


@pytest.mark.parametrize("path", sorted((ROOT / "graphs").glob("*.yaml")), ids=lambda p: p.name)
def test_every_graph_loads(path: Path) -> None:
    plan = load(path)

    assert plan.nodes
    assert plan.edges


def test_no_path_of_one_machine_is_written_down() -> None:
    places = re.compile(r"(?<![\w.}])/(work|farm|home|root|Users)/")

    texts = tracked(".py", ".yaml", ".toml", ".md", "")
    named = [p.name for p in texts if places.search(p.read_text(errors="replace"))]
    assert named in ([], ["test_house_rules.py"])


def test_no_file_holds_both_sides_of_a_merge() -> None:
    marked = re.compile(r"^(<{7}|>{7}) ", re.M)

    both = [p for p in tracked(".py", ".md", ".yaml", ".toml") if marked.search(p.read_text())]

    assert not both


def test_the_readme_names_every_top_folder() -> None:
    readme = (ROOT / "README.md").read_text()

    assert [room for room in ROOMS if f"`{room}/`" not in readme] == []
