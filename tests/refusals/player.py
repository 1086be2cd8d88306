"""Play wrong inputs through the command `fovea`: cases as JSON in, exit codes and words out.

This file runs alone, with the PYTHONPATH of any commit, and imports nothing of the tests. It loads
what commands need once, then forks a process for every case, in a folder of its own or in that of a
graph that runs meanwhile.
"""

import contextlib
import gc
import importlib
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

TIMEOUT_S = 60.0
TOGETHER = 4  # processes at once; some only wait
LOADED = (  # needed by most cases; modules that a commit does not have are skipped
    "pipeline.run.inline", "pipeline.run.supervisor", "pipeline.codec", "pipeline.bus.envelope",
    "pipeline.messages", "drivers.simulated", "operators.capture", "operators.dispatch",
    "operators.policy", "operators.tracker", "operators.saliency", "operators.score",
)  # fmt: skip
LEAVE = os._exit  # the command replaces it with a function that raises
Case = dict[str, Any]
Outcome = dict[str, Any]


def main() -> None:
    """Read `{"folder": …, "cases": […], "graphs": {…}}` from standard input; write outcomes."""
    told = json.load(sys.stdin)
    folder = Path(told["folder"])
    os.environ["NO_COLOR"] = "1"
    (folder / "cases").mkdir()
    load()
    warm_up(folder / "cases" / "warm", told["room"])
    alone = [case for case in told["cases"] if not case["beside"]]
    lanes = {"": lambda: play(alone, lambda number: folder / "cases" / str(number))}
    for name, graph in told["graphs"].items():
        beside = [case for case in told["cases"] if case["beside"] == name]
        if beside:
            room = folder / "cases" / name
            lanes[name] = partial(play_beside, graph, beside, room, folder / f"{name}.log")
    json.dump(at_once(lanes, folder), sys.stdout)


def at_once(lanes: dict[str, Callable[[], dict[str, Outcome]]], folder: Path) -> dict[str, Outcome]:
    """Run each lane in a process of its own; return the outcomes of all."""
    answers: dict[str, Outcome] = {}
    running = {}
    for name, act in lanes.items():
        path = folder / f"lane-{name}.json"
        running[name] = (
            start(partial(_tell, act, path), folder, folder / f"lane-{name}.txt"),
            path,
        )
    for name, (pid, path) in running.items():
        if os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]):
            words = (folder / f"lane-{name}.txt").read_text("utf-8", "replace")
            raise SystemExit(f"{name or 'cases alone'}: {words}")
        answers.update(json.loads(path.read_text()))
    return answers


def play_beside(graph: Case, cases: list[Case], room: Path, said: Path) -> dict[str, Outcome]:
    """Play cases one by one while a graph runs; each may bring files of its own into its room."""
    write(room, graph["files"])
    with contextlib.ExitStack() as running:
        for number, words in enumerate(graph["start"]):
            running.enter_context(background(words, room, said.with_suffix(f".{number}")))
            wait_until(graph["ready"][number], room, said)
        return play(cases, lambda _number: room, 1)


def _tell(act: Callable[[], dict[str, Outcome]], path: Path) -> None:
    """Play a lane with its own home and its own folder for graphs."""
    place = path.with_suffix("")
    for variable in ("HOME", "TMPDIR"):
        os.environ[variable] = str(place / variable[0].lower())
        Path(os.environ[variable]).mkdir(parents=True)
    path.write_text(json.dumps(act()))


def load() -> None:
    """Import the command line, its commands and what they use, so that no case has to."""
    import pipeline.cli
    import pipeline.entry

    for module in LOADED:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    for command in pipeline.cli.commands.commands.values():
        with contextlib.suppress(Exception):
            command.loaded()  # type: ignore[attr-defined]


def warm_up(room: Path, files: dict[str, str]) -> None:
    """Load the graphs of the room once, so that no case has to inspect their classes."""
    from pipeline.graph.loader import load as load_graph

    write(room, files)
    sys.path.insert(0, str(room))
    for path in sorted(room.glob("*.yaml")):
        with contextlib.suppress(Exception):
            load_graph(path)
    sys.path.remove(str(room))
    gc.collect()
    gc.freeze()  # without it, garbage collection in every process would copy this memory


def play(
    cases: list[Case], place: Callable[[int], Path], together: int = TOGETHER
) -> dict[str, Outcome]:
    """Play cases, up to `together` at once; return their outcomes by name."""
    answers: dict[str, Outcome] = {}
    waiting = list(enumerate(cases))
    busy: dict[int, tuple[str, Path, float]] = {}
    while waiting or busy:
        while waiting and len(busy) < together:
            number, case = waiting.pop(0)
            room = place(number)
            write(room, case["files"])
            said = room / f"said-{number}"
            pid = start(lambda case=case: perform(case), room, said)
            busy[pid] = (case["case"], said, time.monotonic())
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid in busy:
            name, said, began_s = busy.pop(pid)
            answers[name] = {
                "exit": os.waitstatus_to_exitcode(status),
                "words": said.read_text("utf-8", "replace"),
                "seconds": round(time.monotonic() - began_s, 2),
            }
        elif not pid:
            time.sleep(0.002)
            for late in [p for p, (_, _, s) in busy.items() if time.monotonic() - s > TIMEOUT_S]:
                os.kill(late, signal.SIGKILL)
    return answers


def perform(case: Case) -> None:
    """Carry out a case: run its command line, or decode its bytes."""
    if case["decoder"]:
        decode(case["decoder"], bytes.fromhex(case["hex"]))
        return
    from pipeline import entry

    sys.argv = ["fovea", *case["fovea"]]
    entry.main()


def decode(decoder: str, data: bytes) -> None:
    """Decode bytes from the wire; a `FoveaError` is printed as one sentence."""
    from pipeline import codec, messages
    from pipeline.bus.envelope import Envelope
    from pipeline.errors import FoveaError

    try:
        if decoder == "envelope":
            Envelope.parse(data)
        elif decoder.startswith("body "):
            codec.unpack(getattr(messages, decoder[5:]), data)
        else:
            codec.loads(getattr(messages, decoder), data)
    except FoveaError as error:
        print(f"fovea: {error}", file=sys.stderr)
        sys.exit(2)


def write(room: Path, files: dict[str, str]) -> None:
    """Write texts under a folder; a text `@hex …` is bytes."""
    room.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        path = room / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if text.startswith("@hex "):
            path.write_bytes(bytes.fromhex(text[5:]))
        else:
            path.write_text(text, "utf-8", "surrogatepass")


def start(act: Callable[[], None], room: Path, said: Path) -> int:
    """Fork a process that acts in a folder, with its standard error in a file; return its id."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        os.setsid()
        os.chdir(room)
        words = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        nothing = os.open(os.devnull, os.O_RDWR)
        for source, target in ((nothing, 0), (nothing, 1), (words, 2)):
            os.dup2(source, target)
        code = _exit_code(act)
    finally:
        LEAVE(code)


def _exit_code(act: Callable[[], None]) -> int:
    try:
        act()
        code: object = 0
    except SystemExit as error:
        code = error.code
        if isinstance(code, str):
            print(code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    return code if isinstance(code, int) else int(code is not None)


@contextlib.contextmanager
def background(words: list[str], room: Path, said: Path) -> Iterator[None]:
    """Run a command in the background; terminate it at the end."""
    pid = start(lambda: perform({"decoder": "", "fovea": words}), room, said)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGTERM)
        late_s = time.monotonic() + TIMEOUT_S
        while os.waitpid(pid, os.WNOHANG) == (0, 0):
            if time.monotonic() > late_s:
                os.kill(pid, signal.SIGKILL)
            time.sleep(0.01)


def wait_until(words: list[str], room: Path, said: Path) -> None:
    """Retry a command until it succeeds, which shows that the graph runs."""
    late_s = time.monotonic() + TIMEOUT_S
    case = {"case": "ready", "fovea": words, "decoder": "", "files": {}}
    while True:
        pid = start(lambda: perform(case), room, said)
        if os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0:
            return
        if time.monotonic() > late_s:
            raise SystemExit(f"{' '.join(words)}: still refused: {said.read_text()}")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
