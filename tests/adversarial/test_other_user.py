"""Another user of the machine can neither read nor affect a running graph."""

import json
import os
from pathlib import Path

import pytest

from pipeline.run.memory_folder import MEMORY
from tests.pipeline.run.namespaces import with_small_mounts


@pytest.mark.lengthy
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_can_neither_read_nor_affect_a_running_graph(tmp_path: Path) -> None:
    told = tmp_path / "other_user.json"
    words = ("-m", "bench.other_user", "--minutes", "0.1", "--json", str(told))

    done = with_small_mounts({MEMORY: "256m"}, *words, timeout_s=200)

    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(told.read_text())
    assert found["achieved"] == {}
    assert (found["torn"], found["crashes"], found["left"]) == (0, 0, [])
    assert found["pictures"] > 0
    assert all(found["tried"][act] for act in ("_read", "precede", "proc", "signal"))
    # the same acts succeed where nothing is protected
    assert {"enter", "_read", "_alter"} <= set(found["decoys"])
