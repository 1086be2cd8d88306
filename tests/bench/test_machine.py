"""The facts of a result name the machine, the versions and the commit."""

import json
from pathlib import Path

from bench.machine import cpu_name, facts, versions


def test_the_facts_are_json_and_name_machine_and_libraries() -> None:
    told = json.loads(json.dumps(facts()))

    assert told["machine"]["cpu"]
    assert told["machine"]["cores"] >= 1
    assert len(told["commit"]) in (0, 40)
    assert {"numpy", "eclipse-zenoh"} <= set(told["libraries"])


def test_a_library_that_is_not_there_is_left_out() -> None:
    assert set(versions(("numpy", "no-such-distribution"))) == {"numpy"}


def test_the_processor_is_named_as_the_system_names_it(tmp_path: Path) -> None:
    listing = tmp_path / "cpuinfo"
    listing.write_text("processor\t: 0\nmodel name\t: Abacus 9000\n")

    assert cpu_name(listing) == "Abacus 9000"
    assert cpu_name(tmp_path / "absent")
