"""The catalogue of wrong inputs: its cases, the answers of a commit, and what an answer lost.

`cases/*.yaml` hold the inputs, `recorded.json` the answers of the commit to compare with. A refusal
must have the exit status and the essential words of the recorded one; intended differences are
explained in the case: `renamed` maps words, `exits` is the reason for another status.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
ROOM = HERE / "room"
RECORDED = HERE / "recorded.json"
GRAPH_FIRST = ("logs", "echo", "hz", "schema")  # commands of a node, with NODE --graph GRAPH before
GRAPHS: Mapping[str, Any] = {  # that run while cases are played beside them
    "live": {"start": [["run", "live.yaml"]], "ready": [["set", "live", "work"]]},
    "deployed": {
        "start": [["agent", "--config", "agent.yaml"]],
        "ready": [["up", "apart.yaml", "--hosts", "solo="]],
    },
}
PLAIN = frozenset({  # words that are not essential
    "a", "an", "the", "of", "is", "are", "was", "were", "it", "its", "to", "in", "on", "at", "by",
    "as", "and", "or", "that", "this", "these", "with", "for", "from", "be", "has", "have", "had",
    "which", "what", "who", "will", "so", "such", "than", "then", "there", "here", "one", "own",
})  # fmt: skip
_NODE = re.compile(r"(\w+)\.(?=\w+=)")  # of NODE.SETTING=VALUE
PART = """\
from dataclasses import dataclass
from pipeline import Frame, Input, Operator, Output
from parts import WorkSettings


class Part(Operator[WorkSettings, None]):
    """
# words with another name in the whole command line: former -> present
RENAMED: Mapping[str, str] = {
    "--papers": "--credentials", "papers": "credentials", "--box": "--host", "box": "host",
    "boxes": "hosts", "--person": "--user", "people": "users",
    "drivers.video:videofile": "drivers.datasets:videofile",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Case:
    """One wrong input."""

    case: str
    fovea: Any = ()  # the command line, as words or as a text
    before: Any = ()  # the same in the words of the former command line
    on: str = "graph.yaml"  # the file of the room that `change` edits
    change: Mapping[str, str] = field(default_factory=dict)
    write: Mapping[str, str] = field(default_factory=dict)
    before_write: Mapping[str, str] = field(default_factory=dict)
    beside: str = ""  # the graph that runs meanwhile
    decoder: str = ""
    hex: str = ""
    new: str = ""  # why the former command line did not refuse it, or refused it otherwise
    renamed: Mapping[str, str] = field(default_factory=dict)  # former words -> present ones
    exits: str = ""  # why the exit status changed

    def played(self, root: Path, *, former: bool) -> dict[str, Any]:
        """Return the case as `player.py` reads it."""
        written = self.before_write if former and self.before_write else self.write
        files = {} if self.beside else dict(_room())
        if self.change:
            files[self.on] = _changed(files[self.on], self.change)
        files |= {name: _text(text) for name, text in written.items()}
        line = self.before if former and self.before else self.fovea
        words = shlex.split(line) if isinstance(line, str) else [str(word) for word in line]
        words = [word.replace("@shipped", str(root / "graphs/sources")) for word in words]
        return {
            "case": self.case, "fovea": ordered(words, former),
            "files": files, "beside": self.beside, "decoder": self.decoder,
            "hex": _repeated(self.hex),
        }  # fmt: skip


@dataclass(frozen=True)
class Refusal:
    """The answer of a command line."""

    status: int
    sentence: str
    whole: str
    seconds: float = 0.0

    @property
    def is_one(self) -> bool:
        """Whether it is a refusal in one sentence: no success, no traceback, no signal."""
        lines = [line for line in self.whole.splitlines() if line.startswith(("fovea:", "Error:"))]
        return self.status in (1, 2) and len(lines) == 1 and "Traceback" not in self.whole


def cases() -> list[Case]:
    """Return all cases in the order of their files; raises `ValueError` for two of one name."""
    found: list[Case] = []
    for path in sorted((HERE / "cases").glob("*.yaml")):
        found += [Case(**entry) for entry in YAML(typ="safe", pure=True).load(path)]
    names = [case.case for case in found]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"two cases of one name: {', '.join(sorted(twice))}")
    return found


def ordered(words: list[str], node_first: bool) -> list[str]:
    """Return a command line with its GRAPH, written in capitals, where its commit expects it.

    >>> ordered(["logs", "LIVE", "work", "-n", "3"], True)
    ['logs', 'work', '-n', '3', '--graph', 'live']
    >>> ordered(["logs", "LIVE", "work"], False)
    ['logs', 'live', 'work']

    NODE of `set` is moved, too; it is written as before, once for every setting.

    >>> ordered(["set", "live", "work.gain=1", "work.words=[a]"], False)
    ['set', 'live', 'work', 'gain=1', 'words=[a]']
    """
    if words[:1] == ["set"] and not node_first and (of := _NODE.match((*words, "", "")[2])):
        return [*words[:2], of[1], *(word.removeprefix(of[0]) for word in words[2:])]
    if len(words) < 2 or words[0] not in GRAPH_FIRST or not words[1].isupper():
        return words
    graph = words[1].lower()
    return [words[0], *words[2:], "--graph", graph] if node_first else [words[0], graph, *words[2:]]


def play(found: list[Case], root: Path = ROOT, *, former: bool = False) -> dict[str, Refusal]:
    """Return the answers of the command line of a source tree to these cases."""
    paths = [str(root), str(root / "pipeline" / "api")]
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(paths)}
    with tempfile.TemporaryDirectory(prefix="r", dir="/tmp") as folder:
        told = {
            "folder": folder,
            "room": _room(),
            "cases": [case.played(root, former=former) for case in found],
            "graphs": {name: {**graph, "files": _room()} for name, graph in GRAPHS.items()},
        }
        done = subprocess.run(
            [sys.executable, "-P", str(HERE / "player.py")], input=json.dumps(told), cwd=folder,
            env=environment | {"LC_ALL": "C.UTF-8"}, text=True, stdout=subprocess.PIPE, check=True,
        )  # fmt: skip
        answers = json.loads(done.stdout)
    return {name: _refusal(answer, folder, root) for name, answer in answers.items()}


def words_of(sentence: str) -> set[str]:
    """Return the essential words of a refusal: places, names, numbers, suggestions.

    >>> sorted(words_of("fovea: graph.yaml:7: work.gian: no such setting, did you mean 'gain'?"))
    ['did', 'gain', 'graph.yaml:7', 'mean', 'no', 'setting', 'such', 'work.gian', 'you']
    """
    bare = re.sub(r"^(fovea|Error): |https?://\S+", "", sentence)
    found = (word.strip(".:?!…") for word in re.split(r"[\s,;()'\"`‘’\[\]{}]+", bare.lower()))
    return {word for word in found if word and word not in PLAIN}


def recorded() -> dict[str, Any]:
    """Return exit status and sentence of every case, by its name."""
    document: dict[str, Any] = json.loads(RECORDED.read_text())
    return document


def lost(case: Case, was: Mapping[str, Any], now: Refusal) -> Iterator[str]:
    """Yield what a refusal lacks that the recorded one has, as sentences."""
    if not now.is_one:
        yield f"expected a refusal in one sentence, got status {now.status} and {now.whole!r}"
    if now.status != was["exit"] and not case.exits:
        yield f"expected exit status {was['exit']}, got {now.status}"
    present = words_of(now.sentence)
    for word in sorted(words_of(was["said"])):
        wanted = words_of(case.renamed.get(word, RENAMED.get(word, word)))
        if not wanted <= present:
            yield f"{word}: not said any more"


def _refusal(answer: Mapping[str, Any], folder: str, root: Path) -> Refusal:
    whole = answer["words"].replace(str(root), "ROOT")
    whole = re.sub(r"(ROOT/[\w/]+\.py):\d+", r"\1", whole)  # a line of fovea's own code
    whole = re.sub(re.escape(folder) + r"(/cases/\w+|/lane-\w*/t)?", "FOLDER", whole)
    lines = [line for line in whole.splitlines() if line.startswith(("fovea: ", "Error: "))]
    sentence = lines[-1] if lines else whole.strip()
    return Refusal(answer["exit"], sentence, whole, answer["seconds"])


def _room() -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(ROOM.iterdir()) if path.is_file()}


def _changed(text: str, change: Mapping[str, str]) -> str:
    for old, new in change.items():
        if old not in text:
            raise ValueError(f"{old!r} is not in the file to be changed")
        text = text.replace(old, _text(new), 1)
    return text


def _text(text: str) -> str:
    """Expand the abbreviations `@part`, `@repeat` and `@digits` in a text of a case."""
    if text.startswith("@part "):
        return f"{PART}{text[6:]}\n"
    return _repeated(text).replace("@digits", "9" * 500)


def _repeated(text: str) -> str:
    """Expand `@repeat COUNT HEAD|UNIT`: HEAD, then COUNT times UNIT, with its number for `{}`."""
    if not text.startswith("@repeat "):
        return text
    _, count, rest = text.split(" ", 2)
    head, bar, unit = rest.partition("|")
    if not bar:
        head, unit = "", rest
    return head + "".join(unit.replace("{}", str(n)) for n in range(int(count)))
