"""Whether and how a camera can foveate, by its description alone."""

from pathlib import Path

import pytest

from drivers.genicam.foveation import foveation, plain_hint
from drivers.genicam.nodes import parse_nodes
from drivers.genicam.vetting import vetted_nodes
from tests.drivers.genicam.virtual_camera import STORED, Nature, describe
from tests.shared_data import Footage

BINNING = ("BinningHorizontal", "BinningVertical")


def verdict(nature: Nature, *, without: str = "", replaced: tuple[str, str] = ("", "")):  # type: ignore[no-untyped-def]
    text = describe(nature).decode()
    if without:
        text = text.replace(f'Name="{without}"', 'Name="Another"')
    if replaced[0]:
        assert replaced[0] in text
        text = text.replace(*replaced)
    return foveation(parse_nodes(text.encode()))


def test_a_camera_whose_features_stay_open_foveates_by_writes() -> None:
    found = verdict(Nature(sensor_px=(256, 128)))

    assert (found.means, found.reason, found.unsure) == ("writes", "", ())
    assert (found.reduction, found.factors) == ("Binning", (2, 3, 4, 5, 6, 7, 8))
    assert (found.field_px, found.size_step_px, found.offset_step_px) == (
        (256, 128),
        (4, 2),
        (4, 2),
    )
    assert found.roi_sizes_px()[:3] == ((128, 64), (84, 42), (64, 32))


def test_an_offset_that_cannot_move_is_the_reason() -> None:
    found = verdict(Nature(locked=("OffsetX", "OffsetY")))

    assert found.means == ""
    assert found.reason == (
        "offset cannot move while it streams (OffsetX is locked); it has no sequencer"
    )


def test_a_field_that_cannot_be_reduced_between_two_rois_is_the_reason() -> None:
    found = verdict(Nature(locked=BINNING))

    assert found.reason == (
        "the full field cannot be seen between two ROIs: BinningHorizontal is locked while it "
        "streams, it has no DecimationHorizontal and DecimationVertical; it has no sequencer"
    )


def test_stored_sets_stand_in_for_features_that_are_locked() -> None:
    found = verdict(Nature(locked=STORED, sets=32))

    assert (found.means, found.sets, found.reduction) == ("sequencer", 32, "Binning")


@pytest.mark.parametrize(
    ("feature", "reason"),
    [
        ("OffsetY", "OffsetY is missing: it has no window to move"),
        ("TriggerSoftware", "TriggerSoftware is missing: no frame can be asked for"),
    ],
)
def test_what_is_missing_is_the_reason(feature: str, reason: str) -> None:
    assert verdict(Nature(), without=feature).reason.startswith(reason)


@pytest.mark.parametrize(
    ("replaced", "reason"),
    [
        (("SequencerSetLoad", "Another"), "it lacks SequencerSetLoad"),
        (('<EnumEntry Name="OffsetX">', '<EnumEntry Name="Gain">'), "does not store OffsetX"),
        (('<EnumEntry Name="BinningVertical">', '<EnumEntry Name="Gain">'), "stores neither"),
        (
            ('<Command Name="SequencerSetLoad">',
             '<Command Name="SequencerSetLoad"><pIsLocked>TLParamsLocked</pIsLocked>'),
            "its sequencer cannot be aimed while it streams (SequencerSetLoad)",
        ),
    ],
)  # fmt: skip
def test_a_sequencer_that_does_not_serve_is_the_reason(
    replaced: tuple[str, str], reason: str
) -> None:
    assert reason in verdict(Nature(locked=STORED, sets=8), replaced=replaced).reason


def lock(formula: str) -> tuple[str, str]:
    """Offset X locked by a formula of the streaming lock T, a register R and a constant."""
    return (
        '<Integer Name="OffsetX">',
        '<IntSwissKnife Name="Lock"><pVariable Name="T">TLParamsLocked</pVariable>'
        '<pVariable Name="R">WidthRegister</pVariable><Constant Name="NEVER">0</Constant>'
        f'<Expression Name="E">T || R</Expression><Formula>{formula}</Formula></IntSwissKnife>'
        '<Integer Name="OffsetX"><pIsLocked>Lock</pIsLocked>',
    )


@pytest.mark.parametrize(
    ("formula", "means", "unsure"),
    [
        ("T || R", "", ()), ("E", "", ()), ("T &amp;&amp; NEVER", "writes", ()),
        ("R = 5", "writes", ("OffsetX",)), ("R ? 0 : T", "writes", ("OffsetX",)),
        ("T = 0", "writes", ()), ("what is this", "writes", ("OffsetX",)),
    ],
)  # fmt: skip
def test_locks_are_computed_for_a_camera_that_streams(
    formula: str, means: str, unsure: tuple[str, ...]
) -> None:
    found = verdict(Nature(), replaced=lock(formula))

    assert (found.means, found.unsure) == (means, unsure)


@pytest.mark.parametrize(("register", "means"), [(5, ""), (4, "writes")])
def test_a_connected_camera_tells_what_its_description_leaves_open(
    register: int, means: str
) -> None:
    text = describe(Nature()).decode().replace(*lock("R = 5")).encode()

    found = foveation(parse_nodes(text), {"WidthRegister": register}.get)

    assert (found.means, found.unsure) == (means, ())


def test_the_hint_names_the_options_of_a_plain_camera() -> None:
    assert "drivers.cameras:CameraSensor" in plain_hint("S7")
    assert 'camera_options: {camera: "S7"}' in plain_hint("S7")
    assert "camera_options" not in plain_hint("")


BINNED = "the full field cannot be seen between two ROIs: BinningHorizontal is locked"
REAL = {
    "Blackfly_S_BFS-U3-16S2M": BINNED,
    "Blackfly_S_BFS-U3-63S4M": BINNED,
    "Chameleon3_CM3-U3-13Y3M": BINNED,
    "Flea3_FL3-U3-13S2M": BINNED,
    "MV-CA013-A0UM": BINNED,
    "Mako_U-029B": "",
    "UI322xCP-M": BINNED,
    "arv-fake-camera": "",
    "issue_66_altered_plain": "OffsetX is missing",
    "issue_67_altered_plain": "OffsetX is missing",
}


@pytest.mark.footage
@pytest.mark.parametrize(("camera", "reason"), REAL.items())
def test_real_cameras_are_judged_by_their_descriptions(
    footage: Footage, camera: str, reason: str
) -> None:
    path: Path = footage.data("genicam") / f"{camera}.xml"

    found = foveation(vetted_nodes(path.read_bytes()))

    assert found.reason.startswith(reason)
    assert found.means == ("" if reason else "writes")
