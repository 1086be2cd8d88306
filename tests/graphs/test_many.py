"""The graphs of many objects: everybody is shown in turn, and tracks get identities."""

import numpy as np
import pytest

from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import graph_path
from pipeline.messages import Message, RoiFeatures, Scanpath, Tracks
from pipeline.run.inline import InlineRunner
from tests.graphs.test_swaps import looks_at

FRAMES = 16


@pytest.mark.lengthy
@pytest.mark.parametrize(("graph", "people"), [("many", 15), ("many_broadcast", 10)])
def test_the_roi_shows_one_after_the_other_and_no_state_is_lost_in_a_swap(
    graph: str, people: int
) -> None:
    seen: dict[str, list[Message]] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Tracks | RoiFeatures | Scanpath):
            seen.setdefault(output, []).append(message)

    plan = load(graph_path(graph), Overlay(clock="lockstep"))
    with InlineRunner(plan, watch=watch) as run:
        states = looks_at(run)
        assert list(run.run(FRAMES)) == list(range(FRAMES))
        undeclared = {name: state.names() for name, state in states.items() if state.names()}

    tracks, named = seen["association.out"][-1], seen["identity.out"][-1]
    assert isinstance(tracks, Tracks)
    assert isinstance(named, Tracks)
    shown = {int(i) for m in seen["roi_features.out"] if isinstance(m, RoiFeatures) for i in m.ids}
    once = max(len(m.ids) for m in seen["roi_features.out"] if isinstance(m, RoiFeatures))
    assert len(shown) > once > 0
    assert len(tracks.ids) > people
    np.testing.assert_array_equal(np.sort(tracks.boxes[:, -1], 0), np.sort(named.boxes[:, -1], 0))
    assert undeclared == {}


def test_a_broadcast_s_people_are_told_apart_by_kits_colours_and_looks() -> None:
    plan = load(graph_path("many_broadcast"))
    association, saliency = plan.node("association").settings, plan.node("saliency").settings

    read = {key: edge.source for key, edge in plan.inputs("association").items()}
    assert read == {"detections": "kits", "frame": "downsample"}
    assert plan.inputs("policy")["tracks"].source == "association"
    # weak detections continue tracks, and begin none
    assert saliency["class_confidence"]["player"] < association["birth_score"]
    assert association["max_objects"] == plan.node("roi_features").settings["max_objects"]
