"""Folders of numbered pictures: the setting `frames`, and folders that are none."""

from pathlib import Path

import pytest

from drivers.datasets.sequence import read_info, span
from pipeline.errors import DriverError, SettingsError


@pytest.mark.parametrize("text", ["", "5-2", "0-3", "0", "-3", "3-", "1-2-3", "a-b", "1.5"])
def test_frames_that_no_sequence_can_have_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="frames: expected A-B, counted from 1, got"):
        span(text)


@pytest.mark.parametrize(
    ("name", "got"),
    [("nowhere", "no such folder"), ("a.txt", "a file"), (".", "one without seqinfo.ini")],
)
def test_what_is_no_folder_of_a_sequence_is_told_what_one_holds(
    name: str, got: str, tmp_path: Path
) -> None:
    (tmp_path / "a.txt").write_text("")

    with pytest.raises(DriverError) as caught:
        read_info(tmp_path / name)

    said = f"{tmp_path / name}: expected the folder of a sequence (seqinfo.ini, img1/), got {got}"
    assert str(caught.value) == said
