"""What a file of weights says about its training."""

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the train extra")

from operators.saliency.training_run import trained_on
from operators.saliency.training_settings import TrainSettings

SCENES = "soccer matches: scenes that fovea draws itself"


def test_weights_of_drawn_scenes_alone_claim_no_stills() -> None:
    assert trained_on(TrainSettings(data=(Path("d"),), out=Path("o"))) == SCENES


@pytest.mark.parametrize(
    ("leave_out", "end"), [(None, ""), ((), ", nothing left out"), (("ab12",), ", ab12 left out")]
)
def test_weights_of_stills_name_the_sets_and_what_was_left_out(
    leave_out: tuple[str, ...] | None, end: str
) -> None:
    more = {} if leave_out is None else {"leave_out": leave_out}
    settings = TrainSettings(
        data=(Path("d"),), out=Path("o"), stills=(Path("/a/football"), Path("/b/wide")), **more
    )

    assert trained_on(settings) == f"{SCENES}, labelled stills (football and wide){end}"
