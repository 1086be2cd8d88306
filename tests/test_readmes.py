"""The pages of the project are correct: links, commands, graphs, operators, versions."""

import contextlib
import importlib
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from ruamel.yaml import YAML

from operators.saliency.description import Description, over
from pipeline import Frame, codec
from pipeline.cli import commands
from pipeline.cli.tasks import VERBS, command_of
from pipeline.errors import GraphError
from pipeline.fleet import agent_file
from pipeline.graph.loader import load
from pipeline.graph.overlay import SOURCE_KEYS, Overlay
from pipeline.graph.plan import Restart
from pipeline.graph.spec import EDGE_KEYS, GRAPH_KEYS, NODE_KEYS
from pipeline.testing import drive, header
from tests.conftest import ROOT
from tests.documents import (
    PAGES,
    READMES,
    Block,
    Line,
    anchors,
    blocks,
    fenced_lines,
    inline_lines,
    links,
    prose_words,
)

MOST_WORDS = 1500
TRACKING = ROOT / "graphs" / "tracking.yaml"
MODULES = {  # the Python blocks that a reader saves, by the name that the page gives the file
    ("README.md", 0): "mine",
    ("README.md", 1): "",  # lines for a notebook
    ("drivers/README.md", 0): "noise",
    ("operators/README.md", 0): "smooth",
    ("operators/README.md", 1): "test_smooth",
}
TORCH = find_spec("torch") is not None


def fenced(first: str) -> list[Line]:
    """Return the fenced command lines of a program, whatever its folder."""
    return [line for line in fenced_lines() if Path(line.words[0]).name == first]


@pytest.fixture
def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder with the Python files that a reader saves, from which they can be imported."""
    for block in blocks("python"):
        key = (str(block.page.relative_to(ROOT)), block.index)
        if MODULES[key]:
            (tmp_path / f"{MODULES[key]}.py").write_text(block.text)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in MODULES.values():
        sys.modules.pop(name, None)


def test_every_folder_of_the_top_level_has_a_page_but_the_tests() -> None:
    rooms = ("pipeline", "pipeline/fleet", "operators", "drivers", "graphs", "bench")

    assert [room for room in rooms if ROOT / room / "README.md" not in READMES] == []


def test_the_readme_is_short() -> None:
    assert prose_words(ROOT / "README.md") <= MOST_WORDS


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    broken = []
    for target in links(page):
        path, _, fragment = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        inside = there.is_relative_to(ROOT) and there.exists()
        if not inside or (fragment and fragment not in anchors(there)):
            broken.append(target)

    assert broken == []


@pytest.mark.parametrize("line", fenced("fovea"), ids=lambda line: line.name)
def test_every_fenced_command_parses(line: Line) -> None:
    verb, *words = line.words[1:]
    if verb in VERBS:
        if verb == "train" and not TORCH:
            pytest.skip("training needs torch")
        if words[0] not in ("mine.yaml",):  # the reader's own task
            parse(command_of(words[0], verb), words[1:])
        return

    parse(commands, [verb, *words])


@pytest.mark.parametrize("line", inline_lines("fovea"), ids=lambda line: line.name)
def test_every_command_in_the_text_exists_with_its_options(line: Line) -> None:
    command: click.Command = commands
    rest = list(line.words[1:])
    while isinstance(command, click.Group) and (rest or not command.invoke_without_command):
        assert rest, f"{line.name}: a group alone"
        word = rest.pop(0)
        if not word.islower():  # a placeholder
            return
        if word.startswith("--"):  # of the group itself
            rest.insert(0, word)
            break
        command = subcommand(command, word)
        if not rest:
            return
    if command.name in VERBS:
        own = rest[0].isupper() or rest[0].endswith(".yaml")
        if own or (command.name == "train" and not TORCH):
            return
        command = command_of(rest[0], str(command.name))

    known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)} | {"--help"}
    assert {word for word in rest if word.startswith("--")} <= known, line.name


@pytest.mark.parametrize(
    "line", [*fenced("python"), *inline_lines("python")], ids=lambda line: line.name
)
def test_every_module_that_is_run_exists_with_its_options(line: Line) -> None:
    flag, module, *words = line.words[1:]
    assert flag == "-m"
    if module == "pytest":
        return
    path = ROOT / module.replace(".", "/")
    source = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
    assert source.is_file(), line.name
    if not module.startswith("bench."):
        return
    options = {word for word in words if word.startswith("--")}

    command = command_in(f"{module}.__main__" if path.is_dir() else module)
    if command is None:  # an argparse one
        assert all(f'"{option}"' in source.read_text() for option in options), line.name
    elif line.fenced:
        parse(command, words)
    else:
        while isinstance(command, click.Group):
            command = subcommand(command, words.pop(0))
        assert options <= {name for p in command.params for name in p.opts}, line.name


@pytest.mark.parametrize("line", fenced("make"), ids=lambda line: line.name)
def test_every_target_of_make_exists(line: Line) -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)

    assert [w for w in line.words[1:] if "=" not in w and w not in targets] == []


def test_every_command_of_fovea_is_described() -> None:
    pages = (ROOT / "pipeline" / "README.md", ROOT / "pipeline" / "fleet" / "README.md")
    text = "".join(page.read_text() for page in pages)

    assert [name for name in names_of(commands) if f"`fovea {name}" not in text] == []


def test_every_key_of_a_graph_is_described() -> None:
    text = (ROOT / "graphs" / "README.md").read_text()
    keys = {*GRAPH_KEYS, *NODE_KEYS, *EDGE_KEYS, *SOURCE_KEYS, *(f.name for f in fields(Restart))}

    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []


@pytest.mark.parametrize("block", blocks("python"), ids=lambda b: b.name)
def test_every_python_block_compiles_and_its_file_is_named(block: Block) -> None:
    compile(block.text, block.name, "exec")

    name = MODULES[str(block.page.relative_to(ROOT)), block.index]
    assert not name or name.startswith("test_") or f"`{name}.py`" in block.page.read_text()


@pytest.mark.parametrize("block", blocks("yaml"), ids=lambda b: b.name)
def test_every_yaml_block_is_a_graph_a_part_of_one_a_source_a_task_or_another_file(
    block: Block, saved: Path
) -> None:
    path = saved / "block.yaml"
    path.write_text(block.text)
    document = YAML(typ="safe").load(block.text)

    if "label" in document:
        assert agent_file.read(path).file.settings
    elif "settings" in document:
        assert load(TRACKING, Overlay(source=path)).nodes
    elif "names" in document:  # what lies beside a detector
        assert over(Description(), path).names
    elif set(document) <= set(VERBS):
        assert all(":" in document[verb] for verb in document)
    elif "capture" in document["nodes"]:
        assert load(path).nodes
    else:
        whole = YAML(typ="safe").load(TRACKING.read_text())
        whole["nodes"] |= document["nodes"]
        YAML().dump(whole, path)
        assert {node.name for node in load(path).nodes} >= set(document["nodes"])


@pytest.mark.parametrize("readme", [ROOT / "README.md", ROOT / "graphs" / "README.md"])
def test_the_error_of_the_readmes_is_what_the_graph_has_with_that_mistake(
    readme: Path, tmp_path: Path
) -> None:
    path = tmp_path / "tracking.yaml"
    wrong = "{frame: capture.context}", "{frame: captur.context}"
    path.write_text(TRACKING.read_text().replace(*wrong, 1))

    with pytest.raises(GraphError) as caught:
        load(path)

    said = str(caught.value).replace(str(path), "graphs/tracking.yaml")
    assert said in readme.read_text()


def test_the_operator_of_the_readme_works_as_described(saved: Path) -> None:
    mine: Any = importlib.import_module("mine")
    frame = Frame(header=header(1), pixels=np.full((4, 6, 3), 100, np.uint8), window=(0, 0, 6, 4))

    (bright,) = drive(mine.Brighten, [frame], {"gain": 2})

    assert (bright.pixels == 200).all()
    assert bright.window == frame.window


def test_the_operator_with_state_passes_the_test_beside_it(saved: Path) -> None:
    test: Any = importlib.import_module("test_smooth")

    test.test_the_mean_moves_towards_the_newest_frame()


def test_the_state_of_that_operator_survives_a_swap(saved: Path) -> None:
    smooth: Any = importlib.import_module("smooth")
    first, second = (smooth.Smooth(smooth.SmoothSettings()) for _ in range(2))
    first.open()
    second.open()
    pixels = np.full((4, 6, 3), 100, np.uint8)
    first.on_frame(Frame(header=header(1), pixels=pixels, window=(0, 0, 6, 4)))

    second.restore(codec.loads(smooth.SmoothState, codec.dumps(first.state())))

    assert second.headline() == "mean 100"
    assert second.do_forget() == {"forgotten": 1}
    assert second.headline() == ""


def test_the_source_of_the_drivers_page_plays_under_the_simulated_sensor(saved: Path) -> None:
    noise: Any = importlib.import_module("noise").Noise(seed=3)

    assert (noise.picture(7) == noise.picture(7)).all()
    assert noise.picture(0).shape == (*noise.size_px[::-1], 3)
    with pytest.raises(IndexError):
        noise.picture(300)


def test_options_of_a_sensor_are_set_without_the_word_options() -> None:
    texts = [*PAGES, *(ROOT / "graphs").rglob("*.yaml")]

    long = [str(path) for path in texts if ".options." in path.read_text()]

    assert long == []
    over = Overlay(
        source=ROOT / "graphs" / "sources" / "usb.yaml", changes=("capture.mode=record",)
    )
    node = next(n for n in load(TRACKING, over).nodes if n.name == "capture")
    assert node.settings["options"]["mode"] == "record"


def test_versions_agree() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    released = re.findall(r"^## \[(\d[^]]*)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())

    assert released[0] == version
    assert citation["version"] == version


def test_ci_runs_what_contributors_run() -> None:
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    job = YAML(typ="safe").load(text)["jobs"]["check-and-test"]

    runs = " ".join(step.get("run", "") for step in job["steps"])
    assert job["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    assert len(job["strategy"]["matrix"]["runner"]) == 2
    assert re.findall(r"make \S+\)?\S* ([\w-]+)", runs.replace('"$(command -v python)"', "P")) == [
        "check",
        "test",
        "test-lengthy",
        "test-hosts",
    ]


def parse(command: click.Command, words: list[str]) -> None:
    """Parse a command line as the command does, without running it."""
    while isinstance(command, click.Group):
        if command.invoke_without_command and (not words or words[0].startswith("-")):
            break  # the group is a command of its own
        command, words = subcommand(command, words[0]), words[1:]
    with contextlib.suppress(click.exceptions.Exit):  # --help
        command.make_context(command.name, list(words))


def subcommand(group: click.Group, name: str) -> click.Command:
    """Return a command of a group; load it if it is loaded on demand."""
    found = group.get_command(click.Context(group), name)
    assert found is not None, f"no command {name}: {', '.join(names_of(group))}"
    loaded: click.Command = getattr(found, "loaded", lambda: found)()
    return loaded


def names_of(group: click.Group) -> list[str]:
    """Return the names of the commands of a group."""
    return group.list_commands(click.Context(group))


def command_in(module: str) -> click.Command | None:
    """Return the click command that a module runs; None for another kind of command line."""
    found = importlib.import_module(module)
    own = [v for v in vars(found).values() if isinstance(v, click.Command)]
    main = getattr(found, "main", None)
    return main if isinstance(main, click.Command) else next(iter(own), None)


@pytest.mark.parametrize("line", [*fenced("pip"), *inline_lines("pip")], ids=lambda line: line.name)
def test_every_extra_exists(line: Line) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = re.findall(r"\.\[([\w,]+)\]", " ".join(line.words))

    extras = {extra for names in named for extra in names.split(",")}
    assert extras <= set(project["optional-dependencies"]), line.name
