"""Agents that have a label and nothing else run a graph on one machine."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from pipeline.errors import SettingsError
from pipeline.fleet.agent_file import AgentFile, HostConfig
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.placement import partners
from tests.pipeline.fleet.agents import fleet_of, handled, plan_of, state_of
from tests.sample_graphs import until

LABELS = ("sensor", "compute", "viewer")


@pytest.fixture
def labelled(tmp_path: Path) -> Iterator[None]:
    """Run `fovea agent --label LABEL` for each label."""
    with ExitStack() as stack:
        for label in LABELS:
            words = ("agent", "--label", label, "--state", str(tmp_path / label))
            agent = stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "pipeline.entry", *words], stdout=subprocess.PIPE
                )
            )
            stack.callback(agent.terminate)
            assert agent.stdout is not None
            assert b"listens" in agent.stdout.readline()
        yield


def sees(fleet: Fleet, label: str, others: frozenset[str]) -> bool:
    hosts = state_of(fleet, label).hosts
    return {host.label for host in hosts} == others and not any(host.lost for host in hosts)


@pytest.mark.usefixtures("labelled")
def test_agents_with_a_label_alone_run_a_graph_and_find_one_another(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path)
    with fleet_of(*LABELS) as fleet:
        up(fleet, plan)

        until(lambda: handled(fleet, "viewer", "count") > 10)
        until(lambda: handled(fleet, "compute", "steer") > 10)
        for label, others in partners(plan).items():
            until(partial(sees, fleet, label, others))
        down("trio", fleet.hosts)


def test_an_agent_with_a_file_allows_only_the_operators_that_it_lists(
    tmp_path: Path,
) -> None:
    path, file = "tests.samples:Pass", AgentFile(label="compute")

    HostConfig(file, tmp_path, any_operator=True).allowed.check_code(path, "work")

    with pytest.raises(SettingsError, match=r"`operators` in its agent\.yaml"):
        HostConfig(file, tmp_path).allowed.check_code(path, "work")
