"""`fovea export`: write a graph's hosts for another engine: systemd, Compose, Kubernetes.

Every host runs an agent under that engine, and `fovea up` deploys the graph to the agents. A graph
without hosts is one service that runs it. The output contains no secrets: credentials are mounted.
"""

from collections.abc import Callable, Mapping

import click

from pipeline.fleet.export.bundle import Bundle
from pipeline.fleet.export.compose import compose
from pipeline.fleet.export.kubernetes import k8s
from pipeline.fleet.export.systemd import systemd
from pipeline.graph.plan import Plan

KINDS: Mapping[str, Callable[[Plan, Bundle], str]] = {
    "systemd": systemd, "compose": compose, "k8s": k8s,
}  # fmt: skip


def engines() -> click.Choice[str]:
    """Return the choice of engines."""
    return click.Choice(list(KINDS))
