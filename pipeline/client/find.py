"""Find the client of a graph by name, whether it runs here or is deployed."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from difflib import get_close_matches

from pipeline.client.deployed import DeployedGraph
from pipeline.client.graph_client import GraphClient, Said, Status
from pipeline.client.local import LocalGraph
from pipeline.errors import FoveaError, RunError
from pipeline.fleet.deploy import AT_ONCE
from pipeline.fleet.remembered import remembered
from pipeline.run.logs import log_lines
from pipeline.run.rundir import folder_of, run_folders, running
from pipeline.settings import suggest


def find(name: str = "") -> GraphClient:
    """Return the graph of that name, or for "" the only one; raises `RunError` if there is none.

    The part of a deployed graph on this host is found by the name `graph@host`.
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
    """Return every graph that runs here or was deployed from here, by name.

    Local parts of a graph that was deployed from here are not listed separately.
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
    """Return the status of every graph for `ps`, without those that end meanwhile.

    They are asked at once: one whose hosts are silent does not delay the others.
    """
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(filter(None, pool.map(_status, graphs().values())))


def _status(client: GraphClient) -> Status | None:
    try:
        return client.status()
    except FoveaError as error:
        if not client.runs():
            return None
        if not isinstance(client, DeployedGraph):
            raise
        # nothing can be asked, e.g. without the credentials that it was deployed with
        hosts: dict[str, Said] = dict.fromkeys(client.hosts.points, str(error))
        return Status(graph=client.name, hosts=hosts, nodes=dict(client.hosts.nodes))


def unknown(graph: str) -> str:
    """Return, as a sentence, that a graph neither runs nor has run here; empty if it does or has.

    Raises `RunError` for what is no graph's name.
    """
    deployed = remembered()
    if graph in deployed or folder_of(graph).is_dir():
        return ""
    names = {*deployed, *(folder.path.name for folder in run_folders())}
    near = get_close_matches(graph, names, 1)  # a list of all that ever ran would be long
    hint = f", did you mean {near[0]!r}?" if near else ""
    return f"no graph {graph} runs or has run here{hint}"


def logs(graph: str, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
    """Yield the last lines of a node's log, also for a graph that ran here and has ended."""
    if why := unknown(graph):
        raise RunError(why)
    ended = graph not in running() and graph not in remembered()
    return (
        log_lines(graph, node, lines, follow=follow)
        if ended
        else find(graph).logs(node, lines, follow=follow)
    )
