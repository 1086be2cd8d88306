"""What a machine has, also in a container with limits and without shared memory."""

from pathlib import Path

import psutil

from pipeline.planner.machine import this_machine


def test_a_container_has_what_its_limits_leave(tmp_path: Path) -> None:
    (tmp_path / "cpu.max").write_text("50000 100000\n")
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("400000\n")

    found = this_machine(tmp_path, tmp_path)

    assert found.cores == 0.5
    assert (found.memory_bytes, found.memory_free_bytes) == (1_000_000, 600_000)
    assert 0 < found.shared_free_bytes <= found.shared_bytes


def test_without_limits_everything_counts_and_without_shared_memory_none(tmp_path: Path) -> None:
    (tmp_path / "memory.max").write_text("max\n")

    found = this_machine(tmp_path / "none", tmp_path)

    assert found.memory_bytes == psutil.virtual_memory().total
    assert (found.shared_bytes, found.shared_free_bytes) == (0, 0)
