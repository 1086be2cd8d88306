"""The command line: `fovea run | check | draw | ps | top | logs | echo | hz | …`.

`fovea --help` loads none of the commands: the table below contains their names and summaries.
"""

import logging
import sys
from typing import Any

import click

from pipeline import exits, output, signals
from pipeline.cli.deferred import Deferred
from pipeline.errors import FoveaError, GraphError, InstallError, SettingsError, WeightsError
from pipeline.extras import remedy
from pipeline.text import error_text, harmless, said_by
from pipeline.user_modules import look_in

LOGGING = ("run", "agent", "router")  # commands whose output is a log; the others print a result
INTERRUPTED = 130
USAGE = (GraphError, InstallError, SettingsError, WeightsError)  # exit status 2
RUN, INSPECTION, CONTROL = "pipeline.cli.run", "pipeline.cli.inspection", "pipeline.cli.control"
FLEET, TASKS = "pipeline.cli.fleet", "pipeline.cli.tasks"
RECORDING = "pipeline.cli.recording"
SENSORS = "drivers.attached.command:sensors_command"  # by its path: no import of a driver here
TABLE = {
    "add": (f"{CONTROL}:add", "Add the nodes of a FILE to a running graph."),
    "agent": (f"{FLEET}:agent_command", "Run parts of graphs on this host for its users."),
    "attach": (f"{FLEET}:attach_command", "Watch a running graph, or adopt one on hosts."),
    "check": ("pipeline.cli.check:check", "Check a graph without starting anything."),
    "completion": ("pipeline.cli.completion:completion", "Print completion code for a SHELL."),
    "doctor": ("pipeline.doctor:doctor_command", "Diagnose this installation, or a graph on it."),
    "down": (f"{FLEET}:down_command", "Stop a graph on all its hosts."),
    "draw": ("pipeline.cli.draw:draw", "Print a graph as a Mermaid chart, SVG or lines."),
    "echo": (f"{INSPECTION}:echo", "Print the messages of an output as they arrive."),
    "eval": (f"{TASKS}:eval_command", "Evaluate a task: figures, tables, plots."),
    "export": (f"{FLEET}:export_command", "Print a graph's hosts as units or manifests."),
    "health": (f"{INSPECTION}:health_command", "Show the health of every node of running graphs."),
    "hz": (f"{INSPECTION}:hz", "Measure rate, jitter and age of an output's messages."),
    "logs": (f"{INSPECTION}:logs", "Show a node's log, also after it has ended."),
    "metrics": ("pipeline.cli.metrics:metrics", "Serve figures of running graphs to Prometheus."),
    "new": ("pipeline.cli.new:new_command", "Create a folder for a new operator, driver or task."),
    "ps": (f"{INSPECTION}:ps", "List the running graphs and their processes."),
    "record": (f"{RECORDING}:record_command", "Record outputs of a graph to an MCAP file."),
    "remove": (f"{CONTROL}:remove", "Remove a node without readers from a running graph."),
    "replay": (f"{RECORDING}:replay_command", "Run a graph on a recording in place of its source."),
    "rewire": (f"{CONTROL}:rewire", "Connect an input of a running graph elsewhere."),
    "router": (
        f"{FLEET}:router_command",
        "Carry messages between hosts that cannot reach one another.",
    ),
    "run": (f"{RUN}:run", "Run a graph until its source ends, a limit or Ctrl-C."),
    "schema": (f"{INSPECTION}:schema_command", "Print inputs and outputs of a running node."),
    "secure": (f"{FLEET}:secure_commands", "Manage a certificate authority for hosts and users."),
    "sensors": (SENSORS, "List the attached sensors; test one."),
    "set": (f"{CONTROL}:set_command", "Change live settings of a running graph."),
    "stop": (f"{CONTROL}:stop", "Stop a running graph, here or on all its hosts."),
    "swap": (f"{CONTROL}:swap", "Replace a node's operator, settings or model file."),
    "tell": (f"{CONTROL}:tell_command", "Call a command of a running node."),
    "top": (f"{INSPECTION}:top", "Watch rates, latencies and drops of a running graph."),
    "trace": ("pipeline.cli.tracing:trace", "Send spans of a running graph to OpenTelemetry."),
    "train": (f"{TASKS}:train_command", "Train the networks of a task."),
    "tune": ("pipeline.cli.tune:tune", "Measure each network; propose the cheapest settings."),
    "up": (f"{FLEET}:up_command", "Start a graph on the hosts that its nodes name."),
    "version": ("pipeline.cli.version:version", "Print version and commit."),
    "view": ("pipeline.cli.view:view", "Watch a running graph in a browser, with Rerun."),
    "weights": ("pipeline.weights:weights_commands", "List and download third-party networks."),
}


class Commands(click.Group):
    """The command group; an error for a missing optional package names its extra."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; raises `InstallError` for a missing package."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            if why := remedy(error):
                raise InstallError(f"{ctx.invoked_subcommand}: {why}") from error
            raise


def main() -> None:
    """Run `fovea`: every expected failure and signal gives one sentence and an exit status."""
    output.guard()
    exits.refuse()
    with signals.raising():
        try:
            look_in()  # the user's operators are in the current folder
            _carry_out()
        except OSError as error:
            if not output.is_lost(error):
                raise
            output.abandon()
            sys.exit(1)
        except KeyboardInterrupt:  # before or after the part that `_carry_out` guards
            sys.exit(INTERRUPTED)


def _carry_out() -> None:
    try:
        commands(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(INTERRUPTED)
    except FoveaError as error:
        output.complain(f"fovea: {error}")
        sys.exit(2 if isinstance(error, USAGE) else 1)
    except OSError as error:  # out of descriptors or disk space
        if output.is_lost(error):
            raise
        where = f"{error.filename}: " if error.filename else ""
        output.complain(f"fovea: {harmless(where + (error.strerror or said_by(error)))}")
        sys.exit(1)
    except MemoryError as error:
        output.complain(f"fovea: {harmless(error_text(error))}")
        sys.exit(1)


def _print_version(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted and not context.resilient_parsing:
        from pipeline.version import described

        click.echo(f"fovea {described()}")
        context.exit()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version,
    help="Show version and commit, and exit.",
)  # fmt: skip
@click.pass_context
def commands(context: click.Context) -> None:
    """Let an ultra-high-resolution image sensor decide, in real time, where to look."""
    from pipeline.bus.session import silence
    from pipeline.terminal import log_handler

    logs = context.invoked_subcommand in LOGGING
    handler = log_handler(stderr=not logs)
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[handler])
    if logs:
        output.forgive()
    else:
        silence()


for _name, (_path, _summary) in TABLE.items():
    commands.add_command(Deferred(_name, _path, _summary))
