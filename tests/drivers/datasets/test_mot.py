"""MOT Challenge sequences: the rows that are truth, and the detections beside them."""

from pathlib import Path

import pytest

from drivers.datasets.mot import MotSequence
from pipeline.errors import DriverError
from tests.drivers.sequences import write_sequence

GT = "1,1,10,20,5,6,1,1,0.5\n1,2,10,20,5,6,0,1,1\n2,3,1.5,2,3,4,1,3,1\n"


def test_ignored_rows_are_left_out_and_visibility_is_kept(tmp_path: Path) -> None:
    sequence = MotSequence(path=str(write_sequence(tmp_path, gt=GT)))

    first, second = sequence.truth(0), sequence.truth(1)
    assert first is not None
    assert second is not None
    assert (first.ids.tolist(), first.labels) == ([1], ("pedestrian",))
    assert first.visibility.tolist() == [0.5]
    assert second.labels == ("car",)
    assert second.boxes.tolist() == [[1.5, 2, 4.5, 6]]


def test_the_ten_columns_of_mot15_read_as_pedestrians(tmp_path: Path) -> None:
    sequence = MotSequence(path=str(write_sequence(tmp_path, gt="1,1,1,2,3,4,1,-1,-1,-1\n")))

    truth = sequence.truth(0)
    assert truth is not None
    assert truth.labels == ("pedestrian",)
    assert truth.visibility.tolist() == [1]


def test_detections_are_given_per_frame_with_confidence(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path)
    (folder / "det").mkdir()
    (folder / "det" / "det.txt").write_text("2,-1,1,2,3,4,0.75\n2,-1,5,6,7,8,0.25,-1,-1,-1\n")
    sequence = MotSequence(path=str(folder))

    boxes, scores = sequence.detections(1)
    assert boxes.tolist() == [[1, 2, 4, 6], [5, 6, 12, 14]]
    assert scores.tolist() == [0.75, 0.25]
    assert sequence.detections(0)[0].shape == (0, 4)
    assert sequence.truth(0) is None


def test_an_unknown_class_names_file_and_line(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, gt=GT + "1,1,1,2,3,4,1,77,1\n")

    with pytest.raises(DriverError, match=r"gt\.txt:4: expected a class from 1 to 13, got 77"):
        MotSequence(path=str(folder))


def test_too_few_columns_name_file_and_line(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, gt="1,1,1,2,3,4,1\n")

    with pytest.raises(DriverError, match=r"gt\.txt:1: expected at least 9 columns, got 7"):
        MotSequence(path=str(folder))
