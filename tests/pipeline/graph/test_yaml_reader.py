"""YAML from outside is read within bounds, and refused with file and line beyond them."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pipeline import FoveaError, GraphError
from pipeline.cli import commands
from pipeline.cli.tasks import command_of
from pipeline.fleet.agent_file import read as read_agent
from pipeline.graph.editing import with_nodes
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, read_change, read_value
from pipeline.graph.yaml_reader import MOST_BYTES, YamlMapping, read_file, read_text
from tests.sample_graphs import CHAIN, plan_of

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{n}: &{n} [{', '.join([f'*{p}'] * 9)}]\n" for p, n in zip("abcdefgh", "bcdefghi", strict=True)
)
BAD = {
    "laughs": (LAUGHS, 5, "up to 20000 values"),
    "brackets": ("a:\n  " + "[" * 3000, 2, "up to 32 levels"),
    "brackets on lines": ("a:\n" + " [\n" * 3000, 34, "up to 32 levels"),
    "dashes": ("- " * 3000, 1, "up to 32 levels"),
    "a long number": ("a: 1\nb: " + "9" * 5000, 2, "a number within 64 bits, got one of 5000"),
    "a number of 400 digits": ("a: " + "9" * 400, 1, "a whole number within 64 bits"),
    "a number of 65 bits": ("a: 18446744073709551616", 1, "a whole number within 64 bits"),
    "infinity": ("a:\n  b: .inf", 2, "expected a finite number, got '.inf'"),
    "nan": ("a: .nan", 1, "expected a finite number, got '.nan'"),
    "a float too large": ("a: 1e999", 1, "expected a finite number"),
    "a key twice": ("a: 1\nb: 2\na: 3", 3, "every key once, got a again"),
    "an object": ("a: !!python/object/apply:os.system [id]", 1, "expected no tag, got"),
    "binary": ("a: !!binary aGk=", 1, "expected no tag, got"),
    "a timestamp": ("a: !!timestamp 2001-01-01", 1, "expected no tag, got"),
    "two documents": ("a: 1\n---\nb: 2", 2, "expected one document"),
    "another version": ("%YAML 1.1\n---\na: off", 2, "expected YAML 1.2, got 1.1"),
    "a number as key": ("a: 1\n2: b", 2, "expected a text as key, got 2"),
    "nothing as key": ("~: b", 1, "expected a text as key, got None"),
    "a list as key": ("? [1]\n: b", 1, "expected a text as key"),
    "an alias of nothing": ("a: *b", 1, "no anchor 'b'"),
    "an alias within itself": ("a: &a\n  b: *a", 2, "stands within what it names"),
    "a merge of no mapping": ("a:\n  <<: [1]", 2, "expected a mapping to merge"),
    "a NUL": ("a: 1\nb: x\0y", 2, "U+0000 is not allowed"),
    "half a character": ('a: "\\ud800"', 1, "half a character"),
    "an escape beyond Unicode": ('a: 1\nb: "\\UFFFFFFFF"', 2, "not YAML"),
    "an open quote": ("a: 1\nb: 'x", 2, "not YAML"),
}


def write(folder: Path, text: str | bytes, name: str = "toy.yaml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(("text", "line", "said"), BAD.values(), ids=BAD)
def test_yaml_that_no_graph_needs_is_refused_with_its_line(
    tmp_path: Path, text: str, line: int, said: str
) -> None:
    path = write(tmp_path, text)

    began_s = time.process_time()
    with pytest.raises(GraphError) as caught:
        read_file(path)

    assert str(caught.value).startswith(f"{path}:{line}: "), str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert time.process_time() - began_s < 5


READERS: dict[str, Callable[[Path, Path], object]] = {
    "a graph": lambda _graph, path: load(path),
    "a source": lambda graph, path: load(graph, Overlay(source=path)),
    "a task": lambda _graph, path: command_of(str(path), "train"),
    "an agent's file": lambda _graph, path: read_agent(path),
    "an addition": lambda graph, path: with_nodes(load(graph), path),
}


@pytest.mark.parametrize("text", [LAUGHS, "a: " + "[" * 3000, "a: 1\na: 2", "a: \0", "[1]", ""])
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_every_kind_of_file_is_read_within_the_same_bounds(
    tmp_path: Path, read: Callable[[Path, Path], object], text: str
) -> None:
    graph = write(tmp_path, f"name: toy\n{CHAIN}", "good.yaml")
    path = write(tmp_path, text)

    with pytest.raises(FoveaError) as caught:
        read(graph, path)

    assert str(caught.value).startswith(f"{path}:")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [text for text, *_ in BAD.values()], ids=BAD)
def test_values_on_a_command_line_are_read_within_the_same_bounds(
    tmp_path: Path, text: str
) -> None:
    graph = write(tmp_path, f"name: toy\n{CHAIN}")

    with pytest.raises(GraphError, match="not a value: "):
        read_value(text, "every")
    with pytest.raises(GraphError, match=r"^count\.every=.*: not a value: "):
        read_change(f"count.every={text}")
    with pytest.raises(GraphError, match=r"^--set count\.every=") as caught:
        load(graph, Overlay(changes=(f"count.every={text}",)))
    assert len(str(caught.value).partition(": not a value")[0]) < 100


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"a: \xff\n", ":1: not YAML: expected UTF-8"),
        ("a: ä\n".encode("utf-16"), ":1: not YAML: "),
        (b"a: 1\n#" + b"x" * MOST_BYTES, f":1: expected up to {MOST_BYTES} bytes"),
    ],
)
def test_bytes_that_are_no_text_or_too_many_are_refused(
    tmp_path: Path, data: bytes, said: str
) -> None:
    with pytest.raises(GraphError, match=said):
        read_file(write(tmp_path, data))


def test_a_path_that_is_no_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")

    for path, said in (
        (tmp_path / "pipe", "expected a file, got no regular file"),
        (tmp_path, "expected a file, got a folder"),
        (Path("/dev/zero"), "expected a file"),
        (tmp_path / "none", "No such file"),
        (Path("a\0b"), "null byte"),
    ):
        with pytest.raises(GraphError, match=said):
            read_file(path)


def test_anchors_aliases_and_merges_are_copied_so_that_a_change_of_one_leaves_the_others(
    tmp_path: Path,
) -> None:
    text = CHAIN.replace("settings: {rate_hz: 20", "settings: &fast {rate_hz: 20")
    text += "  late:\n    operator: tests.samples:Ticker\n    settings: {<<: *fast, length: 9}\n"
    path = write(tmp_path, f"\ufeffname: toy\n{text}")

    plan = load(path, Overlay(changes=("late.side_px=7",)))

    assert plan.node("late").settings == {"rate_hz": 20, "side_px": 7, "length": 9}
    assert plan.node("ticker").settings == {"rate_hz": 20, "side_px": 120}


def test_values_mean_what_yaml_1_2_says() -> None:
    text = "[1, -2, 0x1F, 0o17, 1_000, 1.5, 1e3, true, no, ~, '1', 2001-01-01, '<<', \"\\x41\"]"

    assert read_text(text, "here") == [
        1, -2, 31, 15, 1000, 1.5, 1000.0, True, "no", None, "1", "2001-01-01", "<<", "A",
    ]  # fmt: skip


def test_an_error_about_a_source_file_names_that_file(tmp_path: Path) -> None:
    graph = write(tmp_path, f"name: toy\n{CHAIN}")
    source = write(tmp_path, "\n\nsettings:\n  rate_hz: fast\n", "source.yaml")

    with pytest.raises(FoveaError) as caught:
        load(graph, Overlay(source=source))

    assert str(caught.value).startswith(f"{source}:4: ticker.rate_hz: ")


@given(st.text(max_size=300))
def test_any_text_is_a_value_or_refused_in_one_sentence(text: str) -> None:
    try:
        value = read_text(text, "here")
    except GraphError as error:
        value = None if str(error).startswith("here: ") and "\n" not in str(error) else error
    assert value is None or isinstance(value, (YamlMapping, list, str, int, float))


def test_a_change_below_what_is_no_mapping_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FoveaError, match=r"--set ticker.rate_hz.x=5: ticker.rate_hz: expected a m"):
        plan_of(tmp_path, CHAIN, changes=("ticker.rate_hz.x=5",))


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (["run", "{graph}", "--set", "count.every={value}"], "--set count.every="),
        (["check", "{graph}", "--set", "count.every={value}"], "--set count.every="),
        (["swap", "nowhere", "count", "--set", "every={value}"], "every="),
        (["tell", "nowhere", "count", "recall", "every={value}"], "every="),
    ],
)
@pytest.mark.parametrize("value", [".inf", "[1, .nan]", "9" * 5000, "{a: [" + "x, " * 900])
def test_a_refused_value_names_its_setting_and_is_cut_before_the_reason(
    tmp_path: Path, words: list[str], where: str, value: str
) -> None:
    graph = write(tmp_path, f"name: toy\n{CHAIN}")

    done = CliRunner().invoke(commands, [w.format(graph=graph, value=value) for w in words])

    said = str(done.exception)
    assert said.startswith(f"{where}{value[:40]}{'…' * (len(value) > 40)}: not a value: "), said
    assert len(said) < 300
