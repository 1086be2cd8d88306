"""`fovea train TASK`, `fovea eval TASK`: a task file names the import paths of both commands.

The shipped tasks are in graphs/tasks; a path names one of the user's own.
"""

import sys
from pathlib import Path

import click

from pipeline.errors import GraphError, InstallError
from pipeline.extras import remedy
from pipeline.graph.shipped import TASKS
from pipeline.graph.yaml_lines import YamlFile
from pipeline.import_path import imported
from pipeline.settings import suggest

VERBS = ("train", "eval")


def find(task: str) -> Path:
    """Return the file of a task, by name or path; raises `GraphError`."""
    if task.endswith((".yaml", ".yml")):
        return Path(task)
    known = [path.stem for path in sorted(TASKS.glob("*.yaml")) if commands_of(path)]
    if task not in known:
        raise GraphError(f"no task {task}{suggest(task, known)}")
    return TASKS / f"{task}.yaml"


def commands_of(path: Path) -> dict[str, str]:
    """Return the import paths of a task file by verb; empty for any other YAML file."""
    document = YamlFile(path).document
    return {verb: str(document[verb]) for verb in VERBS if verb in document}


def command_of(task: str, verb: str) -> click.Command:
    """Return the command of a verb; raises `GraphError` naming the file."""
    path = find(task)
    known = commands_of(path)
    if verb not in known:
        if path.parent == TASKS:
            there_is = ", ".join(f"fovea {other} {task}" for other in known)
            raise GraphError(f"fovea {verb} {task}: no such command, there is {there_is}")
        got = ", ".join(known) or "nothing"
        raise GraphError(f"{path}: expected {verb}: module:command, got {got}")
    try:
        found = imported(known[verb], GraphError, f"{path}: {verb}")
    except GraphError as error:
        if isinstance(error.__cause__, ModuleNotFoundError) and (why := remedy(error.__cause__)):
            raise InstallError(f"{verb} {task}: {why}") from error
        raise
    if not isinstance(found, click.Command):
        raise GraphError(f"{path}: {verb}: expected a click command, got {known[verb]}")
    return found


def task_command(verb: str, summary: str) -> click.Command:
    """Return the command `fovea VERB TASK …`, which passes on everything after TASK."""

    @click.command(
        verb, help=summary, context_settings={"ignore_unknown_options": True}, add_help_option=False
    )
    @click.argument("task", required=False)
    @click.argument("words", nargs=-1, type=click.UNPROCESSED)
    def command(task: str | None, words: tuple[str, ...]) -> None:
        if task is None or task in ("-h", "--help"):
            paths = sorted(TASKS.glob("*.yaml"))
            names = [path.stem for path in paths if verb in commands_of(path)]
            click.echo(f"fovea {verb} TASK [OPTIONS]: {summary}\ntasks: {', '.join(names)}")
            return
        found = command_of(task, verb)
        found.context_settings = {"help_option_names": ["-h", "--help"], **found.context_settings}
        sys.exit(found.main(list(words), prog_name=f"fovea {verb} {task}", standalone_mode=False))

    return command


train_command = task_command("train", "Train the networks of a task.")
eval_command = task_command("eval", "Evaluate a task: figures, tables, plots.")
