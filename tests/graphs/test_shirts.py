"""The graph of shirts: numbers are read in the ROI and stay with their tracks."""

import pytest

pytest.importorskip("rapidocr")

from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import graph_path
from pipeline.messages import Message, Percept, Tracks
from pipeline.run.inline import InlineRunner
from tests.graphs.test_swaps import looks_at

FRAMES = 30


@pytest.mark.lengthy
def test_numbers_are_read_and_named_tracks_keep_them_and_no_state_is_lost_in_a_swap() -> None:
    said: list[tuple[int, ...]] = []
    tracks: dict[int, set[int]] = {}
    names: dict[int, str] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Tracks):
            tracks[message.header.seq] = set(message.ids.tolist())
        if isinstance(message, Percept) and output == "names.out":
            said.append((message.header.seq, *message.ids.tolist()))
            names.update(zip(message.ids.tolist(), message.texts, strict=True))

    plan = load(graph_path("shirts"), Overlay(clock="lockstep"))
    with InlineRunner(plan, watch=watch) as run:
        states = looks_at(run)
        assert list(run.run(FRAMES)) == list(range(FRAMES))
        undeclared = {name: state.names() for name, state in states.items() if state.names()}
        summary = run.operator("score").summary()

    assert len(said) == FRAMES
    assert all(set(ids) <= tracks[seq] for seq, *ids in said)
    assert len(names) >= 2
    assert all(text.isdigit() for text in names.values())
    assert summary["read"] >= 2
    assert undeclared == {}
