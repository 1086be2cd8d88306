"""Shipped graphs and sources are found by name from any folder; files by their paths."""

from pathlib import Path

import pytest

from pipeline.errors import GraphError
from pipeline.graph.loader import load
from pipeline.graph.shipped import (
    FOLDER,
    SOURCES,
    graph_names,
    graph_path,
    source_names,
    source_path,
)


def test_a_name_leads_to_the_shipped_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    assert load(graph_path("tracking")).name == "tracking"
    assert graph_path("examples/motion") == FOLDER / "examples" / "motion.yaml"
    assert source_path("soccernet") == SOURCES / "soccernet.yaml"


def test_sources_and_tasks_are_no_graphs() -> None:
    assert "tracking" in graph_names()
    assert not [n for n in graph_names() if n.startswith(("sources/", "tasks/"))]
    assert "video" in source_names()


@pytest.mark.parametrize("word", ["graphs/mine.yaml", "mine.yml", "./tracking", "/tracking"])
def test_what_is_written_like_a_path_is_one(word: str) -> None:
    assert graph_path(word) == Path(word)


def test_a_file_without_a_suffix_is_found_and_a_shipped_name_goes_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mine", "tracking"):
        (tmp_path / name).write_text("nodes: {}")

    assert graph_path("mine") == Path("mine")
    assert graph_path("tracking") == FOLDER / "tracking.yaml"


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(GraphError) as refused:
        graph_path("trackin")

    said = str(refused.value)
    assert said.startswith("'trackin': no such graph; did you mean 'tracking'? there is ")
    assert all(name in said for name in graph_names())
    assert said.endswith("one of your own is named by its path, with .yaml")


@pytest.mark.parametrize("word", ["\0", "a\nb", "x" * 5000, "é/…", "\udc80"])
def test_any_word_that_is_neither_name_nor_path_is_refused_in_one_sentence(word: str) -> None:
    with pytest.raises(GraphError) as refused:
        graph_path(word)

    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 500
