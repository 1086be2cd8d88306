"""SoccerNet sequences: roles, boxes, and the errors for invalid files."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.datasets.sequence import read_rows
from drivers.datasets.soccernet import SoccerNetSequence, parse_role
from pipeline.errors import DriverError, SettingsError
from tests.drivers.sequences import write_sequence
from tests.shared_data import Footage

GAME = """[Sequence]
name=made-up
gameTimeStart=1 - 16:09
num_tracklets=4
trackletID_1= player team left;4
trackletID_2= ball;1
trackletID_3= referee;side bottom
trackletID_4= goalkeepers team right;B
"""
GT = "1,2,10,20,5,6,1,-1,-1,-1\n3,2,12,20,5,6,1,-1,-1,-1\n1,1,0,0,9,20,1,-1,-1,-1\n"


def test_truth_is_returned_per_frame_with_roles_as_labels(tmp_path: Path) -> None:
    sequence = SoccerNetSequence(path=str(write_sequence(tmp_path, gt=GT, gameinfo=GAME)))

    first, second = sequence.truth(0), sequence.truth(1)
    assert first is not None
    assert second is not None
    assert first.labels == ("ball", "player")
    assert first.ids.tolist() == [2, 1]
    assert first.boxes.tolist() == [[10, 20, 15, 26], [0, 0, 9, 20]]
    assert first.visibility.tolist() == [1, 1]
    assert second.boxes.shape == (0, 4)


def test_pictures_come_in_order_at_the_rate_of_seqinfo(tmp_path: Path) -> None:
    sequence = SoccerNetSequence(path=str(write_sequence(tmp_path, gameinfo=GAME)))

    means = [float(sequence.picture(k).mean()) for k in range(3)]
    assert np.allclose(np.diff(means), 10, atol=1)
    assert (sequence.size_px, sequence.rate_hz, sequence.length) == ((64, 48), 25.0, 3)
    assert sequence.truth(0) is None
    with pytest.raises(IndexError):
        sequence.picture(3)


def test_a_sequence_may_begin_with_a_later_frame(tmp_path: Path) -> None:
    path = str(write_sequence(tmp_path, gt=GT, gameinfo=GAME))
    whole, rest = SoccerNetSequence(path=path), SoccerNetSequence(path=path, first=2)

    assert rest.length == 1
    assert (rest.picture(0) == whole.picture(2)).all()
    truth = rest.truth(0)
    assert truth is not None
    assert truth.boxes.tolist() == [[12, 20, 17, 26]]
    with pytest.raises(IndexError):
        rest.picture(1)


@pytest.mark.parametrize("first", [-1, 3])
def test_a_first_frame_that_is_not_there_is_refused(tmp_path: Path, first: int) -> None:
    path = str(write_sequence(tmp_path, gameinfo=GAME))

    with pytest.raises(SettingsError, match=f"one of its 3 frames, from 0 on, got {first}"):
        SoccerNetSequence(path=path, first=first)


@pytest.mark.parametrize(
    ("text", "label", "team", "mark"),
    [
        ("player team left;4", "player", "left", "4"),
        ("player team right;A", "player", "right", "A"),
        ("goalkeepers team left;1", "goalkeeper", "left", "1"),
        ("goalkeeper team right;x", "goalkeeper", "right", "x"),
        ("referee;main", "main referee", "", "main"),
        ("referee;side bottom", "assistant referee", "", "side bottom"),
        ("referee;side top", "assistant referee", "", "side top"),
        ("ball;1", "ball", "", "1"),
    ],
)
def test_every_known_role_has_a_label(text: str, label: str, team: str, mark: str) -> None:
    tracklet = parse_role(text)

    assert (tracklet.label, tracklet.team, tracklet.mark) == (label, team, mark)


@given(st.text())
def test_any_text_is_a_known_role_or_refused(text: str) -> None:
    known = {"ball", "player", "goalkeeper", "main referee", "assistant referee"}

    with contextlib.suppress(ValueError):
        assert parse_role(text).label in known


def test_an_unknown_role_names_file_and_line(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, gameinfo=GAME + "trackletID_5= streaker;1\n")

    with pytest.raises(DriverError, match=r"gameinfo\.ini:9: trackletID_5: .* got 'streaker;1'"):
        SoccerNetSequence(path=str(folder))


@pytest.mark.parametrize(
    ("row", "named"),
    [
        ("1,9,0,0,5,5,1,-1,-1,-1", "expected a tracklet that gameinfo.ini names, got 9"),
        ("1,2,0,0,0,5,1,-1,-1,-1", "expected a box with area, got 0 x 5"),
        ("0,2,0,0,5,5,1,-1,-1,-1", "expected a frame from 1 and a whole id, got 0, 2"),
        ("1,2,0,0,5", "expected at least 6 columns, got 5"),
        ("1,2,left,0,5,5", "expected numbers and commas, got '1,2,left,0,5,5'"),
        ("1,2,nan,0,5,5", "expected finite numbers"),
        ("1,2,1e300,0,5,5", "expected finite numbers"),
    ],
)
def test_a_bad_row_names_file_and_line(tmp_path: Path, row: str, named: str) -> None:
    folder = write_sequence(tmp_path, gt=GT + "\n" + row + "\n", gameinfo=GAME)

    with pytest.raises(DriverError, match=r"gt\.txt:5: " + named):
        SoccerNetSequence(path=str(folder))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(st.sampled_from("0123456789.,-+einfa \t\r\n#"), max_size=80))
def test_any_text_is_rows_or_an_error_that_names_its_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(text, newline="")

    try:
        rows = list(read_rows(path, columns=6))
    except DriverError as error:
        line = int(str(error).removeprefix(f"{path}:").partition(":")[0])
        assert text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[line - 1].strip()
    else:
        for row in rows:
            assert row.index >= 0
            assert row.box[0] <= row.box[2]
            assert row.box[1] <= row.box[3]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(
        st.tuples(
            st.integers(1, 9999),
            st.integers(1, 99),
            st.integers(-500, 4000),
            st.integers(-500, 4000),
            st.integers(1, 4000),
            st.integers(1, 4000),
        )
    )
)
def test_rows_of_boxes_come_back_as_they_were_written(
    tmp_path: Path, rows: list[tuple[int, ...]]
) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("".join(",".join(map(str, row)) + ",1,-1,-1,-1\n" for row in rows))

    read = list(read_rows(path, columns=6))

    assert [
        (r.index + 1, r.id, r.box[0], r.box[1], r.box[2] - r.box[0], r.box[3] - r.box[1])
        for r in read
    ] == rows


SIZES = "[Sequence]\nimWidth=64\nimHeight=48\nseqLength=3\nframeRate=25\n"


@pytest.mark.parametrize(
    ("info", "named"),
    [
        ("name=x\n", "not an ini file"),
        ("[Other]\nname=x\n", r"expected a section \[Sequence\], got \['Other'\]"),
        ("[Sequence]\nimWidth=64\n", "imHeight: expected a number above 0, got no such key"),
        (
            "[Sequence]\nimWidth=64\nimHeight=48\nseqLength=2.5\nframeRate=25\n",
            "seqLength: expected a whole number, got '2.5'",
        ),
        (
            "[Sequence]\nimWidth=64\nimHeight=48\nseqLength=3\nframeRate=-1\n",
            "frameRate: expected a number above 0, got '-1'",
        ),
        (
            "[Sequence]\nimWidth=999999\nimHeight=999999\nseqLength=3\nframeRate=25\n",
            "expected a picture with sides of at most 32768 .*, got 999999x999999",
        ),
        (f"{SIZES}imDir=../other\n", r"imDir: expected a folder .*, got '\.\./other'"),
        (f"{SIZES}imDir=/etc\n", "imDir: expected a folder .*, got '/etc'"),
        (f"{SIZES}imDir=a\0b\n", "imDir: expected a folder"),
        (f"{SIZES}imExt=/../../a.jpg\n", "imExt: expected an ending such as .jpg"),
        (f"{SIZES}imExt=.j\0pg\n", "imExt: expected an ending such as .jpg"),
    ],
)
def test_a_bad_seqinfo_is_refused_in_one_sentence(tmp_path: Path, info: str, named: str) -> None:
    folder = write_sequence(tmp_path, gameinfo=GAME, info=info)

    with pytest.raises(DriverError, match=r"seqinfo\.ini: " + named):
        SoccerNetSequence(path=str(folder))


def test_missing_files_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="expected the folder of a sequence"):
        SoccerNetSequence(path=str(tmp_path / "nowhere"))
    folder = write_sequence(tmp_path, gameinfo=GAME)
    (folder / "img1" / "000003.jpg").unlink()
    with pytest.raises(DriverError, match=r"000003\.jpg: expected picture 3 of 3"):
        SoccerNetSequence(path=str(folder))
    (folder / "gameinfo.ini").unlink()
    write_sequence(tmp_path)
    with pytest.raises(DriverError, match=r"gameinfo\.ini: cannot be read"):
        SoccerNetSequence(path=str(folder))


def test_a_truncated_picture_is_an_error_not_grey(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, gameinfo=GAME)
    picture = folder / "img1" / "000002.jpg"
    picture.write_bytes(picture.read_bytes()[:-20])
    sequence = SoccerNetSequence(path=str(folder))

    with pytest.raises(DriverError, match=r"000002\.jpg: .* truncated"):
        sequence.picture(1)


@pytest.mark.footage
def test_the_real_sequence_reads(footage: Footage) -> None:
    sequence = SoccerNetSequence(path=str(footage.data("soccernet/SNMOT-116a")))

    truth = sequence.truth(0)
    assert (sequence.size_px, sequence.rate_hz, sequence.length) == ((1920, 1080), 25.0, 375)
    assert len(sequence.tracklets) == 27
    assert truth is not None
    assert {"ball", "player", "goalkeeper", "main referee"} <= set(truth.labels)
    assert sequence.picture(374).shape == (1080, 1920, 3)
