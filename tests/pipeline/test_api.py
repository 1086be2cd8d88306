"""`import fovea`: a thin package of names, cheap to import, for scripts and notebooks."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import fovea
import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline import messages
from pipeline.contract import Operator
from tests.sample_graphs import LOOP

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(p.stem for p in (ROOT / "graphs" / "sources").glob("*.yaml"))
HEAVY = ("numpy", "zenoh", "pydantic", "rich", "onnxruntime", "cv2", "pipeline.messages")


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: api\n{LOOP}")
    return path


def test_every_name_is_the_one_of_the_module_that_defines_it() -> None:
    assert fovea.Operator is Operator
    assert fovea.Frame is messages.Frame
    assert {getattr(fovea, name).__module__.partition(".")[0] for name in fovea.__all__} == {
        "pipeline"
    }
    assert set(fovea.__all__) <= set(dir(fovea))


def test_every_message_and_error_that_an_operator_may_use_has_its_name() -> None:
    kinds = [v for v in vars(messages).values() if isinstance(v, type)]
    named = {k.__name__ for k in kinds if issubclass(k, messages.Message)}

    assert named <= set(fovea.__all__)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'fovea' has no attribute 'laod'"):
        fovea.laod  # type: ignore[attr-defined]  # noqa: B018


def test_importing_it_imports_nothing_heavy(tmp_path: Path) -> None:
    code = f"import fovea, sys; print([m for m in {HEAVY} if m in sys.modules])"

    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )

    assert done.stdout.strip() == "[]"


def test_a_graph_runs_in_line_as_often_as_wanted_with_the_same_answers(graph: Path) -> None:
    loaded = fovea.load(graph)

    first, second = (loaded.run(frames=10) for _ in range(2))

    assert first["schedule_sha256"] == second["schedule_sha256"]
    assert first["frames"]["exposed"] == 10
    assert first["clock"] == "lockstep"


def test_a_graph_runs_as_processes_with_the_answers_of_a_run_in_line(graph: Path) -> None:
    loaded = fovea.load(graph, clock="lockstep")

    assert (
        loaded.run(frames=10, processes=True)["schedule_sha256"]
        == loaded.run(frames=10)["schedule_sha256"]
    )


def test_a_run_as_processes_ends_after_its_duration(graph: Path) -> None:
    report = fovea.load(graph, settings={"ticker.rate_hz": 30}).run(processes=True, duration_s=0.5)

    assert report["frames"]["exposed"] > 0
    assert report["clock"] == "realtime"


def test_settings_and_sources_are_laid_over_the_file(tmp_path: Path, graph: Path) -> None:
    source = tmp_path / "source.yaml"
    source.write_text("operator: tests.samples:Ticker\nsettings: {length: 4}\n")

    loaded = fovea.load(graph, source=source, settings={"work.gain": 3})

    assert loaded.plan.node("work").settings["gain"] == 3
    assert loaded.run()["frames"]["exposed"] == 4


def test_watch_sees_every_message_of_a_run_in_line(graph: Path) -> None:
    seen: list[tuple[str, int]] = []

    fovea.load(graph).run(frames=2, watch=lambda name, m: seen.append((name, m.header.seq)))

    assert ("ticker.context", 0) in seen
    assert ("steer.out", 1) in seen


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"settings": {"work": 3}}, "settings: expected keys node.setting, got 'work'"),
        (
            {"settings": {"work.gian": 3}},
            "settings: work.gian: no such setting, did you mean 'gain'?",
        ),
        ({"manual": "viewer"}, "manual: expected a list of nodes, got 'viewer'"),
        (
            {"source": "socer"},
            f"'socer': no such source; did you mean 'soccer'? there is {', '.join(SOURCES)}; "
            "one of your own is named by its path, with .yaml",
        ),
        ({"manual": ["viewer"]}, "no node viewer; there is ticker, work, pair, steer"),
    ],
)
def test_arguments_that_do_not_fit_a_graph_are_refused_in_one_sentence(
    graph: Path, given: dict[str, Any], said: str
) -> None:
    with pytest.raises(fovea.FoveaError) as refused:
        fovea.load(graph, **given)

    assert str(refused.value).removeprefix(f"{graph}: ") == said


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"frames": -1}, "run: expected limits from 0 on, got -1, 0.0"),
        ({"frames": "x"}, "run.frames: expected a whole number, got 'x'"),
        ({"frames": 2.5}, "run.frames: expected a whole number, got 2.5"),
        ({"duration_s": None}, "run.duration_s: expected a number, got None"),
        ({"duration_s": 1.0}, "run.duration_s: expected it with processes=True"),
        ({"processes": True, "watch": print}, "run.watch: expected none for processes, got one"),
    ],
)
def test_limits_that_mean_nothing_are_refused(
    graph: Path, given: dict[str, Any], said: str
) -> None:
    with pytest.raises(fovea.SettingsError, match=said):
        fovea.load(graph).run(**given)


def test_a_graph_that_cannot_go_on_raises_in_both_ways(graph: Path) -> None:
    loaded = fovea.load(graph, settings={"ticker.fail_at": 2})

    for processes in (False, True):
        with pytest.raises(fovea.FoveaError, match="picture 2: torn"):
            loaded.run(frames=5, processes=processes)


def test_the_repr_of_a_graph_has_its_name_size_and_clock(graph: Path) -> None:
    assert repr(fovea.load(graph)) == "Graph(api: 4 nodes, 5 edges, realtime)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Heat(fovea.Message):
    """A message class of a user."""

    degrees: Annotated[NDArray[np.float32], fovea.Shape.of("h", "w")]
    words: tuple[str, ...] = ()


def test_messages_show_arrays_by_dtype_and_sides_and_never_more_than_a_line() -> None:
    message = Heat(
        header=fovea.header(3), degrees=np.zeros((480, 640), np.float32), words=("hot",) * 99
    )

    text = repr(message)

    assert text.startswith("Heat(seq=3, degrees=float32[480, 640], words=('hot', 'hot',")
    assert len(text) < 150
    assert "…" in text


def test_a_message_may_have_a_repr_of_its_own_which_its_subclasses_keep() -> None:
    class Named(Heat):
        def __repr__(self) -> str:
            return "named"

    @dataclass(frozen=True, kw_only=True, eq=False)
    class Sub(Named):
        more: int = 0

    for cls in (Named, Sub):
        assert repr(cls(header=fovea.header(0), degrees=np.zeros((1, 1), np.float32))) == "named"
