"""Advice names the classes of a detector, and warns where the source shows something else."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from operators.capture import CaptureSettings
from operators.saliency import Saliency, SaliencySettings
from operators.saliency.advice import advice
from operators.saliency.description import Description
from pipeline.contract import SOURCE
from pipeline.errors import WeightsError

SOCCER = {"domain": "soccer", "trained_on": "soccer matches"}


@dataclass(frozen=True)
class Shown:
    """The settings of a capture that `advice` reads."""

    shows: str
    source: str = "walk.mp4"


def told(metadata: dict[str, str], shown: Shown | None) -> list[str]:
    return list(advice(["player", "ball"], Description(**metadata), shown))


def test_classes_and_training_data_are_named() -> None:
    assert told(SOCCER, Shown("soccer")) == [
        "the detector finds player, ball; it was trained on soccer matches"
    ]


@pytest.mark.parametrize(
    ("shows", "said"), [("", "does not say what it shows"), ("street", "shows street")]
)
def test_a_source_of_another_kind_is_warned_of(shows: str, said: str) -> None:
    _, warning = told(SOCCER, Shown(shows))

    assert warning.startswith(f"warning: the detector is for soccer, and walk.mp4 {said}: ")
    assert warning.endswith("; another detector is set by this node's weights")


def test_a_detector_without_metadata_is_reported_and_fits_every_source() -> None:
    assert told({}, Shown("street")) == [
        "the detector finds player, ball; its file does not say what it was trained on"
    ]
    assert len(told(SOCCER, None)) == 1


def test_the_shipped_detector_names_its_classes_and_domain() -> None:
    scene = CaptureSettings(options={"scene": "soccer"})
    video = CaptureSettings(options={"source": "drivers.datasets:VideoFile", "path": "walk.mp4"})

    fitting, other = (
        list(Saliency.advise(SaliencySettings(), {SOURCE: source})) for source in (scene, video)
    )

    assert "finds player, referee, ball; it was trained on soccer" in fitting[0]
    assert len(fitting) == 1
    assert "walk.mp4 does not say what it shows" in other[1]


@pytest.mark.parametrize(
    ("source", "shows"),
    [
        ("drivers.datasets:SoccerNetSequence", "soccer"),
        ("drivers.datasets:MotSequence", ""),
        ("drivers.datasets:VideoFile", ""),
        ("drivers.datasets:ImageFolder", ""),
    ],
)
def test_sources_declare_what_they_show(source: str, shows: str) -> None:
    settings = CaptureSettings(options={"source": source, "path": "somewhere"})

    assert (settings.shows, settings.source) == (shows, "somewhere")


def test_renamed_classes_are_listed_by_their_new_names() -> None:
    settings = SaliencySettings(names={"player": "person", "referee": "person"})

    (first,) = Saliency.advise(settings, {})

    assert "finds person; " in first


def test_weights_that_were_not_pulled_are_an_error_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))

    with pytest.raises(WeightsError, match="run `fovea weights pull yolox_nano`"):
        Saliency.advise(SaliencySettings(weights="yolox_nano"), {})
