"""The command line: `fovea run | check | draw | ps | top | logs | echo | hz | …`.

`fovea --help` loads none of the commands: the table below has their names and summaries.
"""

import logging
import sys
from typing import Any

import click

from pipeline import exits, output, signals
from pipeline.cli.deferred import Deferred
from pipeline.errors import FoveaError, GraphError, InstallError, SettingsError, WeightsError
from pipeline.extras import remedy
from pipeline.text import error_text, harmless

LOGGING = ("run", "agent")  # whose output is a log; that of the others is an answer
INTERRUPTED = 130
USAGE = (GraphError, InstallError, SettingsError, WeightsError)  # exit status 2
RUN, INSPECTION, CONTROL = "pipeline.cli.run", "pipeline.cli.inspection", "pipeline.cli.control"
FLEET, TASKS = "pipeline.cli.fleet", "pipeline.cli.tasks"
TABLE = {
    "add": (f"{CONTROL}:add", "Add the nodes of a FILE to a running graph."),
    "agent": (f"{FLEET}:agent_command", "Run parts of graphs on this host for those who may."),
    "attach": (f"{FLEET}:attach_command", "Watch a graph that runs, or look after one on hosts."),
    "check": (f"{RUN}:check", "Check a graph without starting anything."),
    "completion": ("pipeline.cli.completion:completion", "Print what completes words in a SHELL."),
    "doctor": ("pipeline.doctor:doctor_command", "Say what is wrong with this installation."),
    "down": (f"{FLEET}:down_command", "Stop a graph on all its hosts."),
    "draw": (f"{RUN}:draw", "Print the graph as a Mermaid flow chart."),
    "echo": (f"{INSPECTION}:echo", "Print the messages of an output as they come."),
    "eval": (f"{TASKS}:eval_command", "Measure a task: figures, tables, plots."),
    "export": (f"{FLEET}:export_command", "Print a graph's hosts as units or manifests."),
    "health": (f"{INSPECTION}:health_command", "Ask every node of a running graph how it is."),
    "hz": (f"{INSPECTION}:hz", "Measure rate, jitter and age of an output's messages."),
    "logs": (f"{INSPECTION}:logs", "Show what a node wrote, also after it ended."),
    "ps": (f"{INSPECTION}:ps", "List the running graphs and their processes."),
    "remove": (f"{CONTROL}:remove", "Remove a node that nobody reads from a running graph."),
    "rewire": (f"{CONTROL}:rewire", "Let a node of a running graph read another output."),
    "run": (f"{RUN}:run", "Run a graph until its source ends, a limit, or Ctrl-C."),
    "schema": (f"{INSPECTION}:schema_command", "Print what a running node takes and gives."),
    "secure": (f"{FLEET}:secure_commands", "A private certificate authority for hosts and users."),
    "set": (f"{CONTROL}:set_command", "Change live settings of a running graph."),
    "stop": (f"{CONTROL}:stop", "End a running graph, here or on all its hosts."),
    "swap": (f"{CONTROL}:swap", "Replace a node's operator, settings or model file."),
    "tell": (f"{CONTROL}:tell_command", "Have a running node do something."),
    "top": (f"{INSPECTION}:top", "Watch rates, latencies and drops of a running graph."),
    "train": (f"{TASKS}:train_command", "Train the networks of a task."),
    "up": (f"{FLEET}:up_command", "Start a graph on the hosts that its labels name."),
    "version": ("pipeline.cli.version:version", "Print version and commit."),
    "weights": ("pipeline.weights:weights_commands", "Third-party networks: list them, pull them."),
}


class Commands(click.Group):
    """The group; a package that only an extra brings is named together with the extra."""

    def invoke(self, ctx: click.Context) -> Any:
        """Carry out the command; raises `InstallError` for a package that is missing."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            if why := remedy(error):
                raise InstallError(f"{ctx.invoked_subcommand}: {why}") from error
            raise


def main() -> None:
    """Entry point: one sentence and an exit status for every expected failure and every signal."""
    output.guard()
    exits.refuse()
    with signals.raising():
        try:
            sys.path.insert(0, "")  # operators of the user's own lie in the folder they work in
            _carry_out()
        except OSError as error:
            if not output.is_lost(error):
                raise
            output.abandon()
            sys.exit(1)
        except KeyboardInterrupt:  # before or after what `_carry_out` guards
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
    except (OSError, MemoryError) as error:  # no descriptors left, no memory, a full disk
        if isinstance(error, OSError) and output.is_lost(error):
            raise
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
    help="Show version and commit, and leave.",
)  # fmt: skip
@click.pass_context
def commands(context: click.Context) -> None:
    """Let an ultra-high-resolution image sensor decide, in real time, where to look."""
    from pipeline.bus.session import silence
    from pipeline.terminal import log_handler

    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[log_handler()])
    if context.invoked_subcommand in LOGGING:
        output.forgive()
    else:
        silence()


for _name, (_path, _summary) in TABLE.items():
    commands.add_command(Deferred(_name, _path, _summary))
