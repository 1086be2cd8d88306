"""The client of a graph by its name, wherever the graph runs."""

from collections.abc import Iterator

from pipeline.client.deployed import DeployedGraph
from pipeline.client.graph_client import GraphClient, Status
from pipeline.client.local import LocalGraph
from pipeline.errors import RunError
from pipeline.fleet.deploy import remembered
from pipeline.run.logs import log_lines
from pipeline.run.rundir import running
from pipeline.settings import suggest


def find(name: str = "") -> GraphClient:
    """The graph of that name, the only one for ""; raises `RunError` when there is none.

    A part `graph@host` of a deployed graph is found by that name on its host.
    """
    here, deployed = running(), remembered()
    if name in here:
        return LocalGraph(name, here[name])
    if name in deployed:
        return DeployedGraph(name, deployed[name])
    known = graphs()
    if name:
        raise RunError(f"no graph {name} runs{suggest(name, known)}")
    if len(known) == 1:
        return next(iter(known.values()))
    raise RunError(f"expected one running graph, got {', '.join(known) or 'none'}")


def graphs() -> dict[str, GraphClient]:
    """Every graph that runs here or was deployed from here, by name.

    The parts that run here of a graph that was deployed from here are the graph's own.
    """
    here, deployed = running(), remembered()
    found: dict[str, GraphClient] = {
        name: LocalGraph(name, facts)
        for name, facts in here.items()
        if "@" not in name or name.partition("@")[0] not in deployed
    }
    others = {name: hosts for name, hosts in deployed.items() if name not in here}
    found |= {name: DeployedGraph(name, hosts) for name, hosts in others.items()}
    return dict(sorted(found.items()))


def statuses() -> list[Status]:
    """What `ps` shows of every graph; one that ends meanwhile is left out."""
    found = []
    for client in graphs().values():
        try:
            found.append(client.status())
        except RunError:
            if client.runs():
                raise
    return found


def logs(graph: str, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
    """The last lines of a node's log, also of a graph that ran here and has ended."""
    ended = graph not in running() and graph not in remembered()
    return (
        log_lines(graph, node, lines, follow=follow)
        if ended
        else find(graph).logs(node, lines, follow=follow)
    )
