"""Nodes are placed by label, and a host runs only what its own lists allow."""

import hashlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pipeline.errors import FoveaError, GraphError, SettingsError, WeightsError
from pipeline.fleet.links import edge_key, node_permits
from pipeline.fleet.placement import (
    DIGEST_PREFIX,
    Allowed,
    check_labels,
    code_digest,
    listeners,
    partners,
    permitted,
    plan_for,
)
from pipeline.graph.plan import Plan
from pipeline.graph.ports import check_fingerprints, check_operators, declared_ports, fingerprints
from pipeline.node.port_contract import contract_of
from pipeline.protocol.codec import MARKER, TAG, VERSION, decode, encode
from pipeline.protocol.fleet import Prepare, Versions
from tests.pipeline.fleet.agents import ALLOWED, TRIO, plan_of


def inspect(plan: Plan, label: str, allowed: Allowed, over: dict[str, Any]) -> Plan:
    local = permitted(plan, label, allowed, over)
    check_operators(local)
    return local


def allowed(folder: Path, **weights: Path | None) -> Allowed:
    return Allowed(ALLOWED, weights, folder / "store")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("host: viewer", "host: veiwer"), r":24: count\.host: no host veiwer, did you mean 'vi"),
        (("    host: viewer\n", ""), r"graph\.yaml:23: count\.host: expected a host, got none"),
        (("hosts: [sensor, compute, viewer]\n", ""), r"no host sensor; the graph names its hosts"),
        (("[sensor, compute, viewer]", "[sensor, ../viewer]"), r"hosts: expected up to 32 letters"),
        (("[sensor, compute, viewer]", "[sensor, sensor]"), r"different names"),
    ],
)  # fmt: skip
def test_a_label_that_no_host_has_is_refused(
    change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(GraphError, match=said):
        plan_of(tmp_path, TRIO.replace(*change))


def test_a_group_stays_on_one_host(tmp_path: Path) -> None:
    text = TRIO.replace("host: compute\n", "host: compute\n    group: all\n")
    text = text.replace("host: viewer", "host: viewer\n    group: all")

    with pytest.raises(GraphError, match="group all is on compute, got viewer"):
        plan_of(tmp_path, text)


def test_a_label_without_an_agent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="no host viewer among the known agents"):
        check_labels(plan_of(tmp_path), {"sensor": 0, "compute": 0, "viewr": 0})


CHAIN = """
name: chain
hosts: [eye, brain, desk, attic]
nodes:
  capture: {operator: tests.samples:Ticker, host: eye, inputs: {schedule: steer}}
  work: {operator: tests.samples:Pass, host: brain, inputs: {frame: capture.context}}
  tally: {operator: tests.samples:Tally, host: desk, inputs: {frame: work}}
  steer: {operator: tests.samples:Steer, host: desk, inputs: {percept: tally}}
  other: {operator: tests.samples:Ticker, host: attic, inputs: {schedule: steer}}
  count: {operator: tests.samples:Count, host: attic, inputs: {frame: other.context}}
"""
TWO_LOOPS = """
name: loops
hosts: [left, right, brain]
nodes:
  left: {operator: tests.samples:Ticker, host: left, inputs: {schedule: left_steer}}
  left_tally: {operator: tests.samples:Tally, host: brain, inputs: {frame: left.context}}
  left_steer: {operator: tests.samples:Steer, host: brain, inputs: {percept: left_tally}}
  right: {operator: tests.samples:Ticker, host: right, inputs: {schedule: right_steer}}
  right_tally: {operator: tests.samples:Tally, host: brain, inputs: {frame: right.context}}
  right_steer: {operator: tests.samples:Steer, host: brain, inputs: {percept: right_tally}}
"""


def test_partners_share_an_edge_or_the_exposures_of_one_reach_the_other(tmp_path: Path) -> None:
    of_a_chain = {
        "eye": {"brain", "desk", "attic"},  # commands to the attic carry its times
        "brain": {"eye", "desk"},  # nothing that the attic exposes comes here
        "desk": {"eye", "brain", "attic"},
        "attic": {"eye", "desk"},
    }
    of_two_loops = {"left": {"brain"}, "right": {"brain"}, "brain": {"left", "right"}}

    assert partners(plan_of(tmp_path, CHAIN)) == of_a_chain
    assert partners(plan_of(tmp_path, TWO_LOOPS)) == of_two_loops


def test_only_edges_between_hosts_carry_bytes(tmp_path: Path) -> None:
    part = plan_for(plan_of(tmp_path), "compute")

    assert {e.end for e in part.edges if e.transport == "bytes"} == {
        "work.frame", "pair.right", "count.frame", "capture.schedule",
    }  # fmt: skip
    assert set(part.processes()) == {"work", "pair", "steer"}
    assert set(listeners(part, "compute")) == {"work", "pair", "steer"}


def test_a_plan_is_the_same_after_encoding_and_decoding(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)

    assert decode(Prepare, encode(Prepare(plan, Versions.ours(), {}))).plan == plan


def test_a_node_permits_others_only_what_the_edges_of_the_graph_need(tmp_path: Path) -> None:
    part = plan_for(plan_of(tmp_path), "sensor")

    permits = node_permits(part, "capture")

    said = {(p.identity, p.key, p.inward, p.outward) for p in permits}
    context, roi, command = (edge_key(part, part.edges[i]) for i in (1, 3, 0))
    reads = (("declare_subscriber",), ("put",))
    assert said == {
        ("node.trio.work", context, *reads),
        ("node.trio.count", context, *reads),
        ("node.trio.pair", roi, *reads),
        ("node.trio.steer", command, ("put",), ("declare_subscriber",)),
    }


def nested(levels: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(levels):
        value = [value]
    return value


def evil(plan: Plan, node: str, **changes: Any) -> Plan:
    nodes = tuple(replace(n, **changes) if n.name == node else n for n in plan.nodes)
    return replace(plan, nodes=nodes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"operator": "os:system"}, "os:system is not on the allow list"),
        ({"operator": "tests.samples:Nosy"}, "not on the allow list"),
        ({"settings": {"sleep_s": "/etc/shadow"}}, "expected no path from outside"),
        ({"settings": {"sleep_s": {"deep": ["../x"]}}}, "expected no path from outside"),
        ({"settings": {"sleep_s": "subprocess:run"}}, "subprocess:run is not on the allow list"),
        ({"settings": {"sleep_s": DIGEST_PREFIX + "0" * 64}}, "not on the allow list"),
        ({"settings": {"hold": -1.5}}, r"work\.hold"),
        ({"index": 99}, "expected a node with a place of its own"),
        ({"settings": {"sleep_s": "new.rrd"}}, "expected no path from outside"),
        ({"settings": {"sleep_s": {"a/b": 1}}}, "expected no path from outside"),
        ({"settings": {"sleep_s": "os:system "}}, "is not on the allow list"),
        ({"settings": {"sleep_s": "foo-bar:Thing"}}, "is not on the allow list"),
        ({"settings": {"sleep_s": nested(40)}}, "no more than 32 levels"),
    ],
)
def test_a_host_refuses_code_paths_and_names_that_it_does_not_know(
    changes: dict[str, Any], said: str, tmp_path: Path
) -> None:
    plan = evil(plan_of(tmp_path), "work", **changes)

    with pytest.raises(FoveaError, match=said):
        inspect(plan, "compute", allowed(tmp_path), {})


def test_a_process_over_two_hosts_is_refused_by_both(tmp_path: Path) -> None:
    plan = evil(plan_of(tmp_path), "count", group="work", operator="this:s")

    for label in ("compute", "viewer"):
        with pytest.raises(GraphError, match=r"expected the host of its group"):
            inspect(plan, label, allowed(tmp_path), {})


def test_the_code_of_another_host_is_never_loaded_here(tmp_path: Path) -> None:
    sys.modules.pop("this", None)
    plan = evil(plan_of(tmp_path), "capture", operator="this:s")

    part = inspect(plan, "compute", allowed(tmp_path), {})
    contract_of(part, part.node("work"), lambda node: declared_ports(node.operator))

    assert "this" not in sys.modules


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("nodes", {"threads": 10**9}, r"work\.threads: expected 1 to 64"),
        ("nodes", {"stall_s": -1.0}, r"work\.stall_s: expected"),
        ("nodes", {"memory_mb": float("nan")}, r"work\.memory_mb: expected"),
        ("nodes", {"restart": {"backoff_s": -1e9}}, r"backoff_s: expected"),
        ("nodes", {"name": "../work"}, r"expected up to 32 letters"),
        ("edges", {"wait_ms": 1e308}, r"work\.frame\.wait_ms: expected"),
        ("edges", {"depth": 65}, r"work\.frame\.depth: expected 1 to 64"),
        ("edges", {"input": "a/b"}, r"expected up to 32 letters"),
        ("edges", {"source": "nobody"}, r"expected an edge between two nodes"),
        ("edges", {"target": "capture", "input": "schedule"}, r"one for an input"),
    ],
)
def test_a_value_that_no_file_may_have_is_refused_over_the_wire_too(
    part: str, change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    sent = encode(Prepare(plan_of(tmp_path), Versions.ours(), {}))
    written = msgspec.msgpack.decode(sent[2:])
    written["plan"][part][1] |= change
    assert written[TAG] == "Prepare"

    with pytest.raises(FoveaError, match=said):
        decode(Prepare, bytes((MARKER, VERSION)) + msgspec.msgpack.encode(written))


def test_an_edge_to_an_input_that_is_not_declared_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    edges = tuple(replace(e, input="left") if e.end == "work.frame" else e for e in plan.edges)

    with pytest.raises(GraphError, match="no input left"):
        inspect(replace(plan, edges=edges), "compute", allowed(tmp_path), {})


def test_an_input_without_a_writer_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    short = tuple(e for e in plan.edges if e.end != "pair.left")
    short = tuple(replace(e, index=i) for i, e in enumerate(short))

    with pytest.raises(GraphError, match=r"pair\.inputs\.left: required"):
        inspect(replace(plan, edges=short), "compute", allowed(tmp_path), {})


def test_code_that_is_not_what_was_allowed_is_refused(tmp_path: Path) -> None:
    path = "tests.samples:Pass"
    Allowed({path: code_digest(path)}, {}, tmp_path).check_code(path, "work")

    with pytest.raises(SettingsError, match=r"expected code with sha256 00000000"):
        Allowed({path: "0" * 64}, {}, tmp_path).check_code(path, "work")


def test_weights_are_taken_by_checksum_only(tmp_path: Path) -> None:
    data = b"a network"
    digest = hashlib.sha256(data).hexdigest()
    mine = allowed(tmp_path, **{digest: None})
    assert mine.missing({"weights": DIGEST_PREFIX + digest}) == (digest,)

    with pytest.raises(WeightsError, match="not on the allow list"):
        mine.keep(b"another")
    assert mine.keep(data) == digest

    assert mine.localise({"weights": DIGEST_PREFIX + digest}, "x") == {
        "weights": str(tmp_path / "store" / digest)
    }
    (tmp_path / "store" / digest).write_bytes(b"changed")
    with pytest.raises(SettingsError, match="expected sha256"):
        mine.localise(DIGEST_PREFIX + digest, "x")


def test_settings_of_the_host_override_those_of_the_plan(tmp_path: Path) -> None:
    plan = evil(plan_of(tmp_path), "work", settings={"hold": 3, "every": 2})

    part = inspect(plan, "compute", allowed(tmp_path), {"work": {"hold": 1}})

    assert part.node("work").settings == {"hold": 1, "every": 2}


def test_another_schema_is_refused_with_both_sides(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    theirs = {**fingerprints(plan), "capture.context": "00" * 8}

    with pytest.raises(GraphError, match=r"capture\.context: expected messages of schema 0000"):
        check_fingerprints(plan_for(plan, "compute"), theirs)
    check_fingerprints(plan_for(plan, "compute"), fingerprints(plan))
