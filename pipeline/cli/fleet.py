"""`fovea agent | router | up | attach | down | export | secure`: the commands for several hosts."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from pipeline.cli.arguments import GRAPH as GRAPH_NAME
from pipeline.cli.arguments import JSON, print_json
from pipeline.cli.control import end
from pipeline.cli.detached import attach as attach_here
from pipeline.cli.files import try_recording
from pipeline.cli.running import built_settings
from pipeline.client.find import find
from pipeline.errors import FoveaError, RunError, SettingsError
from pipeline.extras import need
from pipeline.file_arguments import GRAPH_FILE, SOURCE_FILE
from pipeline.fleet import secure
from pipeline.fleet.agent import Agent
from pipeline.fleet.agent_file import AgentFile, HostConfig, read
from pipeline.fleet.deploy import Fleet, attach, default_user, up
from pipeline.fleet.export.bundle import Bundle
from pipeline.fleet.export.export import KINDS, engines
from pipeline.fleet.export.systemd import agent_unit
from pipeline.fleet.hosts import known_addresses, read_hosts
from pipeline.fleet.names import check_identity, check_user, user_identity
from pipeline.fleet.placement import identities
from pipeline.fleet.provisioning import check_addressed, issue_for, placed
from pipeline.fleet.remembered import forget as forget_deployed
from pipeline.fleet.remembered import remembered
from pipeline.fleet.router import Router
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.naming import check_name
from pipeline.planner.forecasts import forecasts
from pipeline.planner.pool_plan import pool_plan
from pipeline.renamed import renamed_option
from pipeline.run.heartbeat import Heartbeat
from pipeline.run.reaper import Reaper
from pipeline.run.rundir import running
from pipeline.settings import suggest
from pipeline.signals import Interruption

GRAPH = click.argument("graph", type=GRAPH_FILE)
CREDENTIALS = click.option(
    "--credentials", type=click.Path(path_type=Path, file_okay=False), help="Your credentials."
)


@click.command("agent")
@click.option("--config", type=click.Path(path_type=Path, dir_okay=False), help="The agent's file.")
@click.option(
    "--label", default="", help="Without --config: this host's label; any operator may run."
)
@click.option("--state", type=click.Path(path_type=Path, file_okay=False), help="State folder.")
@click.option(
    "--heartbeat", type=click.Path(path_type=Path, dir_okay=False),
    help="Renew this file while it runs, for a watchdog.",
)  # fmt: skip
@click.option("--unit", is_flag=True, help="Print a systemd unit and exit.")
def agent_command(
    config: Path | None, label: str, state: Path | None, heartbeat: Path | None, unit: bool
) -> None:
    """Run parts of graphs on this host for its users, as permitted by its configuration."""
    if unit:
        config = config or Path("agent.yaml")
        known = read(config).state if config.is_file() else config.resolve().parent
        click.echo(agent_unit(config, state or known, told=state is not None), nl=False)
        return
    if config is None and not label:
        raise click.UsageError("give --config FILE or --label LABEL")
    own = (
        read(config)
        if config
        else HostConfig(AgentFile(label=label), Path.cwd(), any_operator=True)
    )
    if state:
        own = replace(own, file=replace(own.file, state=str(state.resolve())))
    if heartbeat:
        try_recording(heartbeat, "--heartbeat")
    with (
        Interruption(last=True) as asked, Heartbeat(heartbeat) as alive,
        Agent(own, Reaper(), alive) as agent,
    ):  # fmt: skip
        asked.on_signal = agent.stop
        if asked.count:  # asked to end during the start
            agent.stop()
        agent.run()
    logging.getLogger(__name__).info("host %s: stopped", own.label)


@click.command("router")
@click.option(
    "--config", required=True, type=click.Path(path_type=Path, dir_okay=False),
    help="Its router.yaml.",
)  # fmt: skip
def router_command(config: Path) -> None:
    """Carry messages between hosts that cannot reach one another, as its access list permits."""
    with Interruption(last=True) as asked, Router(config) as router:
        asked.on_signal = router.stop
        if asked.count:  # asked to end during the start
            router.stop()
        router.run()
    logging.getLogger(__name__).info("router: stopped")


@click.command("up")
@GRAPH
@click.option(
    "--hosts",
    "words",
    multiple=True,
    metavar="LABEL=ADDRESS,…",
    help="Addresses of hosts; default: from the credentials, else this machine.",
)
@CREDENTIALS
@renamed_option("--papers", "--credentials")
@click.option("--replace", "again", is_flag=True, help="Replace the graph where it already runs.")
@click.option("--source", type=SOURCE_FILE, help="Source of frames: a shipped one or a file.")
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@click.option("--with", "wanted", multiple=True, metavar="NODE", help="A manual node.")
@JSON
def up_command(
    graph: Path, words: tuple[str, ...], credentials: Path | None, again: bool,
    source: Path | None, changes: tuple[str, ...], wanted: tuple[str, ...], as_json: bool,
) -> None:  # fmt: skip
    """Start a graph on the hosts that its nodes name, through their agents."""
    plan = load(graph, Overlay(source, changes, "", wanted))
    with Fleet(read_hosts(words, credentials, plan.hosts)) as fleet:
        up(fleet, plan, again=again)
    hosts = sorted({node.host for node in plan.nodes})
    if as_json:
        nodes = {node.name: node.host for node in plan.nodes}
        print_json({"graph": plan.name, "hosts": hosts, "nodes": nodes})
    else:
        on = ", ".join(hosts)
        click.echo(f"{plan.name}: {len(plan.nodes)} nodes run on {on}; see `fovea ps`")


@click.command("attach")
@GRAPH_NAME
@click.option("--hosts", "words", multiple=True, metavar="LABEL=ADDRESS,…")
@CREDENTIALS
@renamed_option("--papers", "--credentials")
@JSON
def attach_command(
    graph: str, words: tuple[str, ...], credentials: Path | None, as_json: bool
) -> None:
    """Watch a running graph of this host until Ctrl-C, or adopt one on hosts, deployed elsewhere.

    Ctrl-C leaves the graph running. After adoption, `ps`, `top`, `stop` and the other commands
    reach the deployed graph from here.
    """
    if not words and credentials is None and graph in running():
        if as_json:
            print_json(find(graph).status())
        else:
            click.echo(attach_here(find(graph)))
        return
    if not words and credentials is None:
        where = "--hosts LABEL=ADDRESS or --credentials says where else"
        raise RunError(f"no graph {graph} runs here{suggest(graph, running())}; {where}")
    known = known_addresses(credentials) if credentials else {}
    with Fleet(read_hosts(words, credentials, known)) as fleet:
        labels = attach(graph, fleet)
    if as_json:
        print_json({"graph": graph, "hosts": labels})
    else:
        click.echo(f"{graph}: runs on {', '.join(labels)}")


@click.command("down")
@GRAPH_NAME
@click.option("--forget", is_flag=True, help="Stop nothing: only forget where it was deployed.")
@JSON
def down_command(graph: str, forget: bool, as_json: bool) -> None:
    """Stop a graph on all its hosts, as `fovea stop` does."""
    if not forget:
        end(graph, as_json=as_json)
        return
    known = remembered()
    if graph not in known:
        raise RunError(f"{graph}: was not deployed from here{suggest(graph, known)}")
    forget_deployed(graph)
    if as_json:
        print_json({"graph": graph, "hosts": sorted(known[graph].points)})
    else:
        click.echo(f"{graph}: forgotten; `fovea attach` finds it again where it runs")


@click.command("export")
@click.argument("engine", type=engines())
@GRAPH
@click.option(
    "--credentials",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("credentials"),
    show_default=True,
    help="Folder made by `fovea secure`.",
)
@click.option("--user", "name", metavar="NAME", help="User who deploys; default: you.")
@renamed_option("--papers", "--credentials")
@renamed_option("--person", "--user")
def export_command(engine: str, graph: Path, credentials: Path, name: str | None) -> None:
    """Print a graph's hosts as units or manifests for another engine."""
    who = check_user(name or default_user(), "--user")
    plan = load(graph)
    bundle = Bundle(graph.resolve(), credentials.resolve(), who, _known_pools(plan))
    click.echo(KINDS[engine](plan, bundle), nl=False)


def _known_pools(plan: Plan) -> dict[str, int]:
    """Return the bytes of the pools whose size settings tell; none where settings need a host."""
    try:
        rows = pool_plan(plan, forecasts(plan, built_settings(plan))).rows
    except FoveaError:  # e.g. weights that only the host has
        return {}
    return {row.output: row.pool_bytes for row in rows if row.pool_bytes is not None}


@click.group("secure")
def secure_commands() -> None:
    """Manage a private certificate authority for hosts, nodes and users."""


def _identities(command: Callable[..., None]) -> Callable[..., None]:
    """Declare the authority's folder and the identities that get credentials."""
    for option in (
        renamed_option("--person", "--user"),
        click.option("--user", "users", multiple=True, metavar="NAME", help="May deploy."),
        click.option("--graph", "graphs", multiple=True, type=GRAPH_FILE, help="For its nodes."),
        click.option(
            "--router", default="", metavar="ADDRESS", help="Hosts without an address meet there."
        ),
        renamed_option("--box", "--host"),
        click.option(
            "--host", "hosts", multiple=True, metavar="LABEL=ADDRESS", help="Agent's host."
        ),
        click.argument(
            "folder", type=click.Path(path_type=Path, file_okay=False), metavar="CREDENTIALS"
        ),
    ):
        command = option(command)
    return command


@secure_commands.command("init")
@_identities
def init_command(folder: Path, **named: Any) -> None:
    """Create an authority, and credentials for hosts, users and the nodes of graphs."""
    _add(folder, fresh=True, **named)


@secure_commands.command("add")
@_identities
def add_command(folder: Path, **named: Any) -> None:
    """Create missing credentials of an authority; renew those that expire soon."""
    _add(folder, fresh=False, **named)


def _add(
    folder: Path, hosts: tuple[str, ...], graphs: tuple[Path, ...], users: tuple[str, ...],
    router: str, *, fresh: bool,
) -> None:  # fmt: skip
    need("cryptography", "secure")
    addresses: dict[str, str] = {}
    for word in hosts:
        label, _, address = word.partition("=")
        addresses[check_name(label, "--host", SettingsError)] = address
    names = tuple(check_user(name, "--user") for name in users or (default_user(),))
    plans = [load(graph) for graph in graphs]
    addresses = placed(folder, addresses, plans, router)
    check_addressed(folder, addresses, plans)
    nodes = [identity for p in plans for label in p.hosts for identity in identities(p, label)]
    for identity in (*map(user_identity, names), *nodes):
        check_identity(identity)
    if fresh:
        secure.create(folder)
    for line in (*issue_for(folder, addresses, plans, names), *secure.renew(folder)):
        click.echo(line)
    click.echo(f"copy each host's folder to it, keep {folder / 'ca.key'} away from all of them")
    click.echo(f"deploy with --credentials {folder / user_identity(names[0])}")
