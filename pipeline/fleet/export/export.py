"""`fovea export`: a graph's hosts for those who run their own engine: systemd, compose, Kubernetes.

Every host runs an agent under that engine, and `fovea up` places the graph on them. A graph without
hosts is one service that runs it. What is printed holds no secret: credentials are mounted.
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
    """What a graph can be exported for."""
    return click.Choice(list(KINDS))
