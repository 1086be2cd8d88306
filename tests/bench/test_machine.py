"""Every figure says where it was measured."""

import json
import subprocess
from pathlib import Path

from bench.machine import cpu_name, facts, revision, versions


def test_the_facts_are_json_and_name_machine_and_libraries() -> None:
    told = json.loads(json.dumps(facts()))

    assert told["machine"]["cpu"]
    assert told["machine"]["cores"] >= 1
    assert {"numpy", "eclipse-zenoh"} <= set(told["libraries"])


def test_a_library_that_is_not_there_is_left_out() -> None:
    assert set(versions(("numpy", "no-such-distribution"))) == {"numpy"}


def test_the_processor_is_named_as_the_system_names_it(tmp_path: Path) -> None:
    listing = tmp_path / "cpuinfo"
    listing.write_text("processor\t: 0\nmodel name\t: Abacus 9000\n")

    assert cpu_name(listing) == "Abacus 9000"
    assert cpu_name(tmp_path / "absent")


def test_the_commit_is_told_and_whether_the_code_was_changed_since(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        who = ["-c", "user.name=n", "-c", "user.email=n@example.org"]
        subprocess.run(["git", "-C", str(tmp_path), *who, *words], check=True, capture_output=True)

    git("init")
    (tmp_path / "a").write_text("1")
    git("add", "a")
    git("commit", "-m", "first")
    clean = revision(tmp_path)
    (tmp_path / "a").write_text("2")

    assert len(clean["commit"]) == 40
    assert clean["dirty"] is False
    assert revision(tmp_path) == {"commit": clean["commit"], "dirty": True}


def test_code_outside_any_repository_has_no_commit(tmp_path: Path) -> None:
    assert revision(tmp_path / "nowhere") == {"commit": "", "dirty": False}
