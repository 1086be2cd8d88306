"""What `fovea record` tells is what its files hold, and its recorder does not stay behind."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from click.testing import CliRunner

pytest.importorskip("mcap")

from pipeline import RunError, SettingsError
from pipeline.cli.recording import _incomplete, _print_counts, record_command
from pipeline.client import recording
from pipeline.client.find import find
from pipeline.client.local import LocalGraph
from pipeline.recording.reader import Recording, end_of
from pipeline.recording.recorder import Limits, Recorder
from pipeline.run.supervisor import Supervisor
from tests.pipeline.recording.test_recorder import frame
from tests.sample_graphs import CHAIN, beside, go, plan_of, together, wait_for

TOGETHER = together(CHAIN, "ticker", "count", "glance")


class Ended:
    """A client of a graph that has ended."""

    name = "over"

    def runs(self) -> bool:
        return False

    def status(self) -> NoReturn:
        raise RunError("over: the graph has ended")

    def command(self, *_: object) -> NoReturn:
        raise RunError("over: the graph has ended")


def followed(path: Path) -> recording.Outcome:
    """Return what is told of a recording whose graph ended before the recorder was asked."""
    client: Any = Ended()
    return recording.follow(client, path, 0, lambda: 0, lambda _accounts: None)


def messages(files: list[str], output: str) -> int:
    return sum(len(Recording(Path(file)).messages.get(output, {})) for file in files)


def test_every_file_of_a_graph_that_ended_is_told_with_its_counts(tmp_path: Path) -> None:
    path = tmp_path / "a[1].mcap"
    recorder = Recorder(path, Limits(chunk_bytes=2000, file_bytes=8000))
    for seq in range(100):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.close()

    found = followed(path)

    assert len(recorder.files) > 10  # also in order behind the ninth
    assert (found.files, found.failure) == ([str(file) for file in recorder.files], "")
    assert found.outputs["capture.context"]["recorded"] == 100
    assert messages(found.files, "capture.context") == 100


def test_a_file_without_its_end_is_told_as_a_failure(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recorder = Recorder(path)
    recorder.add("capture.context", frame(0), wait=True)
    recorder.close()
    path.write_bytes(path.read_bytes()[:-100])

    assert followed(path).failure == f"{path}: not written to its end; its whole chunks can be read"


def test_a_recorder_that_was_restarted_is_told_as_a_failure_with_all_its_messages(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.mcap"
    for seq in range(2):
        recorder = Recorder(path, Limits(chunk_bytes=1))
        recorder.add("capture.context", frame(seq), wait=True)
        recorder.close()
    path.write_bytes(path.read_bytes()[:-100])

    found = followed(path)

    assert found.failure.startswith(f"{path}: not written to its end; ")
    assert "then the recorder was restarted" in found.failure
    assert found.outputs["capture.context"]["recorded"] == messages(found.files, "capture.context")
    assert messages(found.files, "capture.context") == 2


ENDING = """
import sys
from pathlib import Path
from pipeline.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]))
print("records", flush=True)
sys.stdin.readline()
recorder.close()
"""


class Running(Ended):
    """A client of a graph that runs."""

    def runs(self) -> bool:
        return True


class Removing(Running):
    """A client of a graph from which another command removes the recorder, which then ends."""

    def __init__(self, recorder: "subprocess.Popen[str]") -> None:
        self.recorder = recorder
        self.facts = {"nodes": [{"name": "record", "process": "record"}],
                      "pids": {"record": recorder.pid}}  # fmt: skip

    def status(self) -> Any:
        return SimpleNamespace(hosts={})

    def nodes(self) -> tuple[str, ...]:
        assert self.recorder.stdin is not None
        self.recorder.stdin.close()
        return ()


def test_a_recorder_that_was_removed_writes_its_end_before_its_files_are_told(
    tmp_path: Path,
) -> None:
    words = [sys.executable, "-c", ENDING, str(tmp_path / "a.mcap")]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as recorder:
        assert recorder.stdout is not None
        recorder.stdout.readline()
        client: Any = Removing(recorder)

        found = recording.follow(client, tmp_path / "a.mcap", 0, lambda: 0, lambda _accounts: None)

    assert (found.removed, found.failure) == (True, "")


@pytest.mark.parametrize(("cls", "what"), [(Running, "goes on"), (Ended, "has ended")])
def test_an_incomplete_recording_is_told_with_what_became_of_the_graph(
    cls: type[Ended], what: str
) -> None:
    client: Any = cls()

    said = _incomplete(client, "a.mcap: No space left on device")

    assert said == f"over: {what}; the recording is incomplete: a.mcap: No space left on device"


def client_of(name: str) -> LocalGraph:
    client = find(name)
    assert isinstance(client, LocalGraph)
    return client


def test_the_counts_that_are_told_are_those_of_the_files(tmp_path: Path) -> None:
    plan, told = plan_of(tmp_path, TOGETHER), list[recording.Outcome]()

    def record() -> recording.Outcome:
        client, path = client_of(plan.name), tmp_path / "a.mcap"
        what = recording.chosen(client, ())
        with recording.begun(client, path, what, {"file_s": 0.3}):
            return recording.follow(client, path, 1.0, lambda: 0, lambda _accounts: None)

    def look(supervisor: Supervisor) -> None:
        told.append(beside(supervisor, record))
        supervisor.finish()

    go(plan, 0, look)

    (found,) = told
    assert found.outputs["ticker.roi"]["recorded"] == messages(found.files, "ticker.roi") > 5
    assert len(found.files) > 1


def test_a_recorder_that_another_command_removes_is_told_with_its_counts(tmp_path: Path) -> None:
    plan, path, told = plan_of(tmp_path, TOGETHER), tmp_path / "a.mcap", list[recording.Outcome]()

    def record() -> recording.Outcome:
        client, looks = client_of(plan.name), list[int]()
        recording.begin(client, path, recording.chosen(client, ()), {})

        def asked() -> int:
            looks.append(len(looks))
            if len(looks) == 3:
                client_of(plan.name).remove("record")
            return 0

        return recording.follow(client, path, 0, asked, lambda _accounts: None)

    def look(supervisor: Supervisor) -> None:
        told.append(beside(supervisor, record))
        supervisor.finish()

    go(plan, 0, look)

    (found,) = told
    assert (found.removed, found.failure) == (True, "")
    assert [edge.origin for edge in found.accounts] == ["ticker.roi"]
    assert found.outputs["ticker.roi"]["recorded"] == messages(found.files, "ticker.roi")


def test_counts_of_a_recorder_that_was_removed_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    counts = {"recorded": 3, "dropped": 0, "passed": 2, "gaps": 0, "refused": 0}

    _print_counts(recording.Outcome(outputs={"work.out": counts}, removed=True))

    assert capsys.readouterr().out == "work: 3 messages; 2 passed through the ring\n"


def test_a_second_recorder_is_told_of_the_first_and_a_failure_leaves_none(tmp_path: Path) -> None:
    plan, paths, left = plan_of(tmp_path, TOGETHER), [tmp_path / n for n in "ab"], list[bool]()

    def record() -> None:
        client = client_of(plan.name)
        what = recording.chosen(client, ("ticker.roi",))
        with recording.begun(client, paths[0], what, {}):
            recording.begin(client_of(plan.name), paths[1], what, {})

    def look(supervisor: Supervisor) -> None:
        with pytest.raises(RunError) as refused:
            beside(supervisor, record)
        said.append(str(refused.value))
        left.append("record" in client_of(plan.name).nodes())
        supervisor.finish()

    said: list[str] = []
    go(plan, 0, look)

    assert said == [
        f"{plan.name}: expected no node record, got one, which records to {paths[0]}; "
        f"`fovea remove {plan.name} record` ends it"
    ]
    assert left == [False]


def test_a_link_to_no_file_is_refused_as_a_place_for_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.symlink_to(tmp_path / "b.mcap")

    done = CliRunner().invoke(record_command, ["tracking", "--inline", "--out", str(path)])

    assert isinstance(done.exception, SettingsError)
    assert str(done.exception) == f"--out {path}: expected a new file, got a link"


def test_a_recorder_leaves_the_graph_when_its_command_was_killed(tmp_path: Path) -> None:
    plan, path = plan_of(tmp_path, TOGETHER), tmp_path / "a.mcap"
    words = [sys.executable, "-m", "pipeline.cli", "record", plan.name, "--out", str(path)]

    def look(supervisor: Supervisor) -> None:
        def recording_since() -> bool:
            return "record" in client_of(plan.name).nodes()

        with subprocess.Popen(words, stdout=subprocess.PIPE) as command:
            try:
                assert command.stdout is not None
                beside(supervisor, command.stdout.readline)  # "recording 2 outputs"
                assert recording_since()
            finally:
                command.kill()
        wait_for(supervisor, lambda: not recording_since())
        supervisor.finish()

    report = go(plan, 0, look)

    assert not report["failure"]
    assert end_of(path) is not None  # it was ended as any other
