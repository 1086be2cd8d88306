"""The evaluation calls operators as a graph does, and refuses the same wrong answers."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.tracking.options import GRAPH
from bench.tracking.stages import Stages
from pipeline import FoveaError, Input, Operator, RoiSchedule, Scanpath
from pipeline.testing import header

NAME = f"{__name__}:Wrong"


@dataclass(frozen=True, kw_only=True)
class WrongSettings:
    """The kind of wrong answer."""

    answer: str = ""


class Wrong(Operator[WrongSettings, RoiSchedule]):
    """Takes the place of dispatch and answers wrongly."""

    scanpath = Input(Scanpath, keep="every")

    def on_scanpath(self, scanpath: Scanpath) -> Any:
        windows = np.zeros((2, 4), np.int32)
        right = RoiSchedule(header=scanpath.header, first_seq=1, windows=windows)
        wrong: dict[str, Any] = {
            "a number": 42,
            "an unknown output": {"oops": right},
            "another message": scanpath,
            "another shape": replace(right, windows=windows[:, :3]),
            "a fraction": replace(right, first_seq=0.5),  # type: ignore[arg-type]
        }
        if self.settings.answer == "written input":
            scanpath.boxes.fill(0)
        return wrong.get(self.settings.answer, right)


def scanpath() -> Scanpath:
    return Scanpath(
        header=header(),
        ids=np.zeros(0, np.int32),
        probability=np.zeros((2, 0), np.float32),
        choice=np.full(2, -1, np.int32),
        boxes=np.ones((2, 4), np.float32),
        first_seq=1,
    )


def stages(folder: Path, answer: str) -> Stages:
    node = f"{NAME}\n    settings: {{answer: {answer}}}"
    graph = folder / "wrong.yaml"
    graph.write_text(GRAPH.read_text().replace("operators.dispatch:Dispatch", node))
    return Stages(graph, policy="pursuit")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("a number", "dispatch: expected a message per output (out) or None, got an int"),
        (
            "an unknown output",
            "dispatch: expected answers for its outputs (out), got one for 'oops'",
        ),
        ("another message", "dispatch.out: expected a RoiSchedule or None, got a Scanpath"),
        ("another shape", "dispatch.out: RoiSchedule.windows: expected shape (frames, 4) or"),
        ("a fraction", "dispatch.out: RoiSchedule.first_seq: expected int, got a float 0.5"),
    ],
)
def test_a_wrong_answer_is_refused_in_an_evaluation_too(
    tmp_path: Path, answer: str, said: str
) -> None:
    with pytest.raises(FoveaError, match=re.escape(said)):
        stages(tmp_path, answer).call("dispatch", scanpath=scanpath())


def test_a_stage_of_an_evaluation_cannot_write_into_what_it_is_handed(tmp_path: Path) -> None:
    given = scanpath()

    with pytest.raises(ValueError, match="read-only"):
        stages(tmp_path, "written input").call("dispatch", scanpath=given)

    assert given.boxes.all()
