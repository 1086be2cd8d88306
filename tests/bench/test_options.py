"""A bench that cannot run prints the reason in one sentence."""

from pathlib import Path
from types import ModuleType

import pytest
from click import ClickException, Command
from click.testing import CliRunner

from bench import crash, identity_gain, kalman, loop, scene, soak
from bench.manipulation import evaluate as manipulation
from bench.manipulation import gain, looking
from bench.reading import evaluate as reading
from bench.shirts import evaluate as shirts
from bench.tracking import evaluate as tracking
from pipeline.errors import GraphError
from pipeline.graph.shipped import graph_path


@pytest.mark.parametrize("bench", [crash, loop, soak])
def test_a_wrong_setting_is_one_sentence_and_exit_status_1(bench: object, tmp_path: Path) -> None:
    graph = tmp_path / "graph.yaml"
    graph.write_text("name: x\nnodes:\n  ticker:\n    operator: tests.samples:Ticker\n")

    done = CliRunner().invoke(bench.main, [str(graph), "--set", "ticker.rate=3"])  # type: ignore[attr-defined]

    assert done.exit_code == 1
    assert done.output.startswith("Error: ")
    assert "did you mean 'rate_hz'" in done.output
    assert len(done.output.splitlines()) == 1


@pytest.mark.parametrize("bench", [kalman, scene])
def test_footage_that_is_not_there_is_one_sentence_and_exit_status_2(
    bench: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["bench", "--data", "/nowhere"])

    with pytest.raises(SystemExit) as ended:
        bench.main()

    assert ended.value.code == 2
    assert "error: /nowhere" in capsys.readouterr().err


@pytest.mark.parametrize("command", [identity_gain.main, gain.command, looking.command])
def test_figures_that_cannot_be_written_are_refused_before_the_work(
    command: Command, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("")

    for path in (tmp_path, file / "below.json"):
        done = CliRunner().invoke(command, ["--json", str(path)])
        assert done.exit_code == 2
        assert "Invalid value for '--json'" in done.output
    with command.make_context("bench", ["--json", str(tmp_path / "new" / "figures.json")]):
        assert (tmp_path / "new").is_dir()
    with command.make_context("bench", ["--json", "/dev/stdout"]):
        assert Path("/dev/stdout").exists()


@pytest.mark.parametrize("evaluation", [tracking, reading, shirts, manipulation])
def test_an_evaluation_takes_a_shipped_graph_by_name_or_the_path_of_a_file(
    evaluation: ModuleType,
) -> None:
    def graph(*words: str) -> object:
        line = ["--data", "procedural"] if evaluation is tracking else []
        with evaluation.command.make_context("eval", [*line, *words]) as context:
            return context.params["graph"]

    assert graph() == str(evaluation.GRAPH)
    assert graph("--graph", "follow") == str(graph_path("follow"))
    assert graph("--graph", "my/graph.yaml") == "my/graph.yaml"
    with pytest.raises((GraphError, ClickException), match="did you mean 'tracking'"):
        graph("--graph", "trackin")


def test_an_unknown_graph_is_one_sentence() -> None:
    done = CliRunner().invoke(loop.main, ["nosuch"])

    assert done.exit_code == 1
    assert done.output.startswith("Error: 'nosuch': no such graph")
