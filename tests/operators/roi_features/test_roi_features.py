"""The encoder with a network that returns the mean colour of each crop."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from operators.roi_features import RoiEncoder
from operators.roi_features.crops import FILL, cut, shrunk, to_squares
from pipeline import Frame, MessageError, RoiFeatures, SettingsError, Tracks, WeightsError
from pipeline.testing import drive, header, picture
from tests.operators.networks import mean_encoder, verifying_encoder
from tests.shared_data import Footage

WINDOW = (480, 270, 960, 540)


def roi_with(*patches: tuple[int, int, int, int, int]) -> Frame:
    """Return a grey ROI with patches (left, top, right, bottom, red) in its pixels."""
    pixels = np.full((270, 480, 3), FILL, np.uint8)
    for left, top, right, bottom, red in patches:
        pixels[top:bottom, left:right] = (red, 0, 0)
    return Frame(header=header(3), pixels=pixels, window=WINDOW)


def tracks_at(*boxes: tuple[float, float, float, float]) -> Tracks:
    """Return tracks 10, 11, … with these newest boxes, in sensor pixels; scores increase."""
    n = len(boxes)
    newest = np.array(boxes, np.float32).reshape(n, 1, 4)
    return Tracks(
        header=header(3),
        ids=np.arange(10, 10 + n, dtype=np.int32),
        labels=np.zeros(n, np.int32),
        scores=np.linspace(0.1, 0.9, n).astype(np.float32),
        boxes=np.concatenate([np.zeros_like(newest), newest], 1),
        visible=np.ones((n, 2), np.bool_),
        features=np.zeros((n, 2, 0), np.float32),
        predicted=np.zeros((n, 0, 4), np.float32),
    )


def encoded(weights: str, roi: Frame, tracks: Tracks, **settings: object) -> RoiFeatures:
    """Return the operator's output for one exposure."""
    (answer,) = drive(RoiEncoder, [{"roi": roi, "tracks": tracks}], {"weights": weights} | settings)
    assert isinstance(answer, RoiFeatures)
    return answer


@pytest.mark.parametrize(("batch", "as_map"), [("n", False), (1, True), (4, False)])
def test_each_object_inside_is_encoded_for_any_size_of_batch(
    tmp_path: Path, batch: int | str, as_map: bool
) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch=batch, side_px=32, as_map=as_map)
    roi = roi_with((20, 20, 120, 120, 200), (220, 120, 320, 220, 100))
    inside = tracks_at((500, 290, 600, 390), (0, 0, 100, 100), (700, 390, 800, 490))

    answer = encoded(weights, roi, inside, margin=0.0)

    assert answer.ids.tolist() == [10, 12]
    assert answer.features == pytest.approx(
        np.array([[200 / 255, 0, 0], [100 / 255, 0, 0]]), abs=1e-5
    )
    assert answer.header.seq == 3


def test_each_object_is_encoded_in_the_window_that_shows_most_of_it(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    first = roi_with((20, 20, 120, 120, 200))
    second = replace(roi_with((0, 0, 480, 270, 50)), window=(900, 270, 1380, 540))
    unread = Frame(header=header(3), pixels=np.zeros((0, 0, 3), np.uint8))
    # the middle one is half in the first window and wholly in the second; the last in none
    tracks = tracks_at((500, 290, 600, 390), (910, 300, 1010, 400), (1500, 600, 1600, 700))

    (answer,) = drive(
        RoiEncoder,
        [{"roi": first, "tracks": tracks, "roi_2": second, "roi_3": unread}],
        {"weights": weights, "margin": 0.0},
    )

    assert answer.ids.tolist() == [10, 11]
    assert answer.features[:, 0] == pytest.approx([200 / 255, 50 / 255], abs=1e-5)


def test_a_binned_roi_is_read_at_its_own_scale(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px="s", as_map=False)
    full = roi_with((20, 20, 120, 120, 200))
    binned = Frame(
        header=full.header, pixels=np.ascontiguousarray(full.pixels[::2, ::2]), window=WINDOW
    )

    answer = encoded(weights, binned, tracks_at((500, 290, 600, 390)), margin=0.0, crop_px=48)

    assert answer.features == pytest.approx(np.array([[200 / 255, 0, 0]]), abs=1e-5)


def test_a_candidate_is_genuine_where_the_network_finds_the_class_of_its_label(
    tmp_path: Path,
) -> None:
    weights = verifying_encoder(tmp_path / "e.onnx", names="ball background", classes=2)
    roi = roi_with((20, 20, 120, 120, 200), (220, 120, 320, 220, 0))
    tracks = tracks_at((500, 290, 600, 390), (700, 390, 800, 490))

    as_balls = encoded(weights, roi, replace(tracks, names=("ball",)), margin=0.0)
    unknown = encoded(weights, roi, replace(tracks, names=("giraffe",)), margin=0.0)
    unlabelled = encoded(weights, roi, tracks, margin=0.0)

    sure = 1 / (1 + np.exp(-10 * 200 / 255))
    assert as_balls.genuine == pytest.approx(np.array([sure, 0.5]), abs=1e-4)
    assert unknown.genuine.tolist() == unlabelled.genuine.tolist() == [1.0, 1.0]


def test_every_candidate_is_genuine_for_a_network_without_classes(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    tracks = replace(tracks_at((500, 290, 600, 390)), names=("ball",))

    assert encoded(weights, roi_with(), tracks).genuine.tolist() == [1.0]


def test_a_network_must_name_its_classes(tmp_path: Path) -> None:
    weights = verifying_encoder(tmp_path / "e.onnx", names="ball", classes=2)

    with pytest.raises(WeightsError, match="expected names of 2 classes in its metadata, got 1"):
        encoded(weights, roi_with(), tracks_at())


def test_no_object_inside_and_no_roi_give_empty_arrays(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    nothing = Frame(header=header(3), pixels=np.zeros((0, 0, 3), np.uint8))

    outside = encoded(weights, roi_with(), tracks_at((0, 0, 100, 100)))
    unread = encoded(weights, nothing, tracks_at((500, 290, 600, 390)))

    assert outside.features.shape == unread.features.shape == (0, 3)
    assert outside.ids.shape == unread.ids.shape == (0,)


def test_half_of_a_box_must_be_seen_and_the_best_are_kept(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    crossing = tracks_at((380, 300, 500, 400), (460, 300, 520, 400), (600, 300, 660, 400))

    assert encoded(weights, roi_with(), crossing).ids.tolist() == [11, 12]
    assert encoded(weights, roi_with(), crossing, max_objects=1).ids.tolist() == [12]


def test_mean_deviation_and_channel_order_are_applied(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    roi = roi_with((20, 20, 120, 120, 204))
    tracks = tracks_at((500, 290, 600, 390))

    answer = encoded(
        weights, roi, tracks, margin=0.0, mean=(0.3, 0.5, 0.1), std=(0.5, 0.25, 1.0), bgr=True
    )

    assert answer.features == pytest.approx(np.array([[-0.1, -2.0, 1.0]]), abs=1e-5)


@given(
    arrays(np.float32, 2, elements=st.floats(-300, 700, width=32)),
    st.floats(0.5, 900),
    st.integers(1, 40),
)
def test_any_square_can_be_cut(corner: NDArray[np.float32], side: float, canvas_px: int) -> None:
    picture = np.full((27, 48, 3), 200, np.uint8)
    squares = np.array([[*corner, *(corner + side)], [0, 0, 27, 27]], np.float32)

    one, other = (np.array(crop) for crop in cut(picture, squares, (canvas_px, canvas_px)))

    assert one.shape == other.shape == (canvas_px, canvas_px, 3)
    assert set(np.unique(one)) <= {FILL, 200}
    assert (other == 200).all()


@pytest.mark.parametrize("side", [(64, 64), (65, 64), (97, 90), (96, 33)])
def test_shrinking_gives_what_opencv_gives_for_bytes(side: tuple[int, int]) -> None:
    crop = picture(*side, seed=1)

    found = shrunk(crop, (32, 32))

    assert np.array_equal(found, cv2.resize(crop, (32, 32), interpolation=cv2.INTER_AREA))


def test_squares_keep_the_centre_and_cover_the_box() -> None:
    roi = roi_with()
    squares = to_squares(np.array([[500, 290, 540, 390]], np.float32), roi, 0.2)

    assert squares == pytest.approx(np.array([[-20, 10, 100, 130]]))


def test_a_mosaic_is_refused_with_a_hint(tmp_path: Path) -> None:
    weights = mean_encoder(tmp_path / "e.onnx", batch="n", side_px=32, as_map=False)
    mosaic = Frame(
        header=header(3),
        pixels=np.zeros((270, 480), np.uint8),
        pixel_format="bayer_rggb8",
        window=WINDOW,
    )

    with pytest.raises(MessageError, match="expected rgb8 pixels, got bayer_rggb8"):
        encoded(weights, mosaic, tracks_at((500, 290, 600, 390)))


def test_missing_weights_are_named(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"none\.onnx: no such weights"):
        encoded(str(tmp_path / "none.onnx"), roi_with(), tracks_at())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"crop_px": 0}, "crop_px: must be at least 1, got 0"),
        ({"batch": -1}, "batch: must not be negative"),
        ({"inside": 0.0}, "inside: must be above 0"),
        ({"margin": -1.0}, "margin: must not be negative"),
        ({"std": (1.0, 0.0, 1.0)}, "std: must be above 0"),
    ],
)
def test_a_wrong_setting_is_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        encoded("unread.onnx", roi_with(), tracks_at(), **settings)


@pytest.mark.footage
def test_an_encoder_of_one_crop_at_a_time_tells_objects_apart(footage: Footage) -> None:
    roi = roi_with((20, 20, 120, 120, 200), (220, 120, 320, 220, 200))
    cv2.circle(roi.pixels, (270, 170), 20, (0, 255, 255), -1)

    answer = encoded(
        str(footage.weights("nanotrack_v3_backbone")),
        roi,
        tracks_at((500, 290, 600, 390), (700, 390, 800, 490), (500, 290, 600, 390)),
        crop_px=127,
        batch=1,
        std=(1 / 255,) * 3,
        bgr=True,
    )

    assert answer.features.shape == (3, 96)
    assert np.array_equal(answer.features[0], answer.features[2])
    assert not np.allclose(answer.features[0], answer.features[1], atol=1e-2)
