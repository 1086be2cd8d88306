"""Commands with `--json`, and the documented keys of their answers."""

import json
from collections.abc import Iterable
from typing import Any

from click.testing import CliRunner

from pipeline.cli import commands

# GRAPH with the nodes work (tests.samples:Pass), count and spare (tests.samples:Count); FILE adds
# the node tally. `work` reads `capture.context`.
ANSWERS: dict[str, set[str]] = {
    "ps": {"hosts", "nodes"},  # below the graph's name
    "top GRAPH --once --every-s 0.1": {"graph", "hosts", "nodes"},
    "health GRAPH": {"work", "count", "capture"},  # likewise
    "schema GRAPH work": {"inputs", "outputs", "settings", "commands"},
    "logs GRAPH work": set(),  # lines of a log that may be empty
    "echo GRAPH work --count 1": {"seq", "status", "pixels", "window"},
    "hz GRAPH work --duration-s 5": {"rate_hz", "age_ms_p50", "missed"},
    "set GRAPH work every=1": {"node", "settings", "live"},
    "tell GRAPH work recall": {"held"},
    "swap GRAPH work --probation 1": {"node", "hot", "seq", "gap_ms", "state", "proven_frames"},
    "add GRAPH FILE": {"added", "removed", "connected", "cut"},
    "remove GRAPH spare": {"added", "removed", "connected", "cut"},
    "stop GRAPH": {"graph", "stopped", "exit_status", "report"},
}
BELOW = ("ps", "health")  # their answers have a key for every graph


def answer(words: str, **places: str) -> tuple[int, list[Any]]:
    """Run a command; return its exit status and its JSON: one value, or one for each line."""
    given = [places.get(word, word) for word in words.split()]
    done = CliRunner().invoke(commands, [*given, "--json"])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    try:
        return done.exit_code, [json.loads(done.stdout)]
    except ValueError:
        return done.exit_code, [json.loads(line) for line in done.stdout.splitlines()]


def check(words: Iterable[str], **places: str) -> None:
    """Assert that each of these commands answers with its keys."""
    for line in words:
        status, found = answer(line, **places)
        assert status == 0, line
        for value in found:
            keys = value[places["GRAPH"]] if line.split()[0] in BELOW else value
            assert keys.keys() >= ANSWERS[line], (line, keys)
        assert found or not ANSWERS[line], line
