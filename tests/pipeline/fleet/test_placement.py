"""Nodes are placed by label, and a host runs only what its own lists allow."""

import hashlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pipeline.bus.ledger import private_ledger
from pipeline.errors import FoveaError, GraphError, SettingsError, WeightsError
from pipeline.fleet.links import edge_key, node_permits
from pipeline.fleet.peers import DRIFT, READ, WRITTEN, Offset, Replication, adopt
from pipeline.fleet.placement import (
    DIGEST_PREFIX,
    Allowed,
    check_labels,
    code_digest,
    listeners,
    permitted,
    plan_for,
)
from pipeline.graph.plan import Plan
from pipeline.graph.ports import check_fingerprints, check_operators, declared_ports, fingerprints
from pipeline.node.port_contract import contract_of
from pipeline.protocol.codec import MARKER, TAG, VERSION, decode, encode
from pipeline.protocol.fleet import Accounts, Prepare, Versions
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


def test_an_offset_lies_within_its_error_whatever_the_delays() -> None:
    clock, ahead = Offset(), 1_000_000_000_000
    ways = [(5_000_000, 100_000), (200_000, 300_000), (90_000, 4_000_000), (150_000, 9_000_000)]
    now = 0
    for there, back in ways:
        came = now + there + ahead
        clock.add(now, came, came + 50_000, now + there + 50_000 + back)
        now += 200_000_000

    seen = clock.estimate(now)

    assert seen is not None
    assert abs(seen.offset_ns - ahead) <= seen.error_ns
    assert seen.error_ns <= 250_000 + DRIFT * 800_000_000
    later = clock.estimate(now + 60_000_000_000)
    assert later is not None
    assert later.error_ns > 5_000_000  # the last measurement is a minute old: clocks drift


def test_each_host_counts_its_half_and_receives_the_other(tmp_path: Path) -> None:
    sensor, viewer = (plan_for(plan_of(tmp_path), name) for name in ("sensor", "viewer"))
    edge = next(e.index for e in sensor.edges if e.end == "count.frame")
    ledgers = [private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2)]
    here, there = (
        Replication(sensor, ledgers[0], "viewer"),
        Replication(viewer, ledgers[1], "sensor"),
    )
    ledgers[0].edges[edge].sent = 9
    ledgers[1].edges[edge].delivered, ledgers[1].edges[edge].seen = 7, 8
    ledgers[1].edges[edge].reader_epoch = 1

    for one, other in ((here, there), (there, here)):
        told = one.tell(ready=True, anyway=False)
        assert told is not None
        other.hear(told)
        assert one.tell(ready=True, anyway=False) is None

    assert (ledgers[0].edges[edge].seen, ledgers[0].edges[edge].in_flight) == (8, 2)
    assert ledgers[1].edges[edge].sent == 9
    here.lost()
    assert not ledgers[0].edges[edge].live  # a writer waits for no reader that is gone


def test_a_restarted_host_continues_from_the_accounts_of_the_others(tmp_path: Path) -> None:
    sensor, viewer = (plan_for(plan_of(tmp_path), name) for name in ("sensor", "viewer"))
    old, fresh = (private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2))
    edge = next(e.index for e in sensor.edges if e.end == "count.frame")
    old.edges[edge].sent, old.edges[edge].seen, old.edges[edge].delivered = 20, 19, 18

    adopt(sensor, fresh, [Replication(viewer, old, "sensor").whole()])

    assert fresh.edges[edge].sent == 20
    siblings = sensor.readers("capture", "context")
    assert {fresh.edges[e.index].sent for e in siblings} == {20}


def test_a_local_edge_beside_one_between_hosts_begins_at_zero(tmp_path: Path) -> None:
    text = TRIO + "  near:\n    operator: tests.samples:Count\n    host: sensor\n"
    text += "    inputs: {frame: capture.context}\n"
    sensor, viewer = (plan_for(plan_of(tmp_path, text), name) for name in ("sensor", "viewer"))
    old, fresh = (private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2))
    far, near = (
        next(e.index for e in sensor.edges if e.end == end) for end in ("count.frame", "near.frame")
    )
    old.edges[far].sent = old.edges[far].seen = old.edges[far].delivered = 20

    adopt(sensor, fresh, [Replication(viewer, old, "sensor").whole()])

    assert (fresh.edges[near].sent, fresh.edges[near].lost_in_crash) == (0, 0)
    assert fresh.edges[near].base == 20


def test_counts_of_edges_that_are_not_of_the_sending_host_are_ignored(tmp_path: Path) -> None:
    plan = plan_for(plan_of(tmp_path), "sensor")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    everything = {e.index: (99,) * len(WRITTEN) for e in plan.edges}
    halves = {e.index: (99,) * len(READ) for e in plan.edges}

    Replication(plan, ledger, "viewer").hear(Accounts(1, "", True, everything, halves))

    for edge in plan.edges:
        account = ledger.edges[edge.index]
        assert account.sent == 0  # it writes nothing here
        assert account.seen == (99 if edge.end == "count.frame" else 0)


def test_counts_of_another_graph_of_that_name_are_ignored(tmp_path: Path) -> None:
    plan = plan_for(plan_of(tmp_path), "sensor")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    theirs = Replication(plan_for(plan_of(tmp_path), "viewer"), ledger, "sensor", fingerprint="old")
    mine = private_ledger(len(plan.edges), len(plan.nodes))
    edge = next(e.index for e in plan.edges if e.end == "count.frame")
    ledger.edges[edge].reader_epoch = 7

    told = theirs.tell(ready=True, anyway=True)
    assert told is not None
    Replication(plan, mine, "viewer", fingerprint="new").hear(told)
    assert mine.edges[edge].reader_epoch == 0

    Replication(plan, mine, "viewer", fingerprint="old").hear(told)
    assert mine.edges[edge].reader_epoch == 7


def test_a_clock_that_was_reset_is_followed_at_once() -> None:
    clock = Offset()
    for k in range(64):
        now = k * 200_000_000
        clock.add(now, now + 10**12, now + 10**12, now + 100_000)

    now = 64 * 200_000_000
    clock.add(now, 5_000_000, 5_000_000, now + 5_000_000)

    seen = clock.estimate(now + 5_000_000)
    assert seen is not None
    assert abs(seen.offset_ns - (2_500_000 - now)) <= seen.error_ns
