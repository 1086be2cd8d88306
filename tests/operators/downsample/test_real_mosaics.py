"""Raw frames of real cameras: 10 and 14 bit, all four orders."""

import cv2
import numpy as np
import pytest

from operators.downsample import Downsample
from pipeline.messages import Frame
from pipeline.pixel_formats import FORMATS, ORDERS
from pipeline.testing import drive, header
from tests.drivers.packing import packed
from tests.shared_data import Footage

pytestmark = pytest.mark.footage
ROSE = {"black_level": 600, "gamma": 2.2}
CHART = {  # patches of a test chart, place (x, y) and what their colour is like
    "orange": (754, 365), "cyan": (879, 365), "navy": (943, 365), "green": (1009, 360),
    "brown": (1077, 360), "yellow": (765, 748), "grey": (502, 607),
}  # fmt: skip


def rose(footage: Footage, order: str) -> np.ndarray:
    path = footage.data(f"raw/DSC_1339_768x512_{order}.raw")
    return np.fromfile(path, "<u2").reshape(512, 768)


def chart(footage: Footage) -> np.ndarray:
    path = footage.data("raw/openISP_test_1920x1080_rggb.RAW")
    return np.fromfile(path, "<u2").reshape(1080, 1920)


def shown(samples: np.ndarray, name: str, **settings: object) -> np.ndarray:
    pixels = packed(samples, FORMATS[name])
    frame = Frame(header=header(), pixels=pixels, pixel_format=name, window=(0, 0, 8, 8))
    (got,) = drive(Downsample, [frame], settings)
    return got.pixels.astype(int)


@pytest.mark.parametrize("order", ORDERS)
def test_one_scene_has_the_same_colours_in_every_order(footage: Footage, order: str) -> None:
    reference = shown(rose(footage, "rggb"), "bayer_rggb14", width_px=192, **ROSE)

    got = shown(rose(footage, order), f"bayer_{order}14", width_px=192, **ROSE)
    whole = shown(rose(footage, order), f"bayer_{order}14", **ROSE)
    wrong = shown(rose(footage, order), "bayer_bggr14" if order != "bggr" else "bayer_rggb14",
                  width_px=192, **ROSE)  # fmt: skip

    assert np.array_equal(got, reference)  # the files hold the same superpixels
    petals = whole[200:400, 200:300].reshape(-1, 3).mean(0)
    assert petals[0] > 1.3 * petals[1:].max()
    assert np.abs(wrong - reference).mean() > 10


@pytest.mark.parametrize("order", ORDERS)
def test_a_full_size_picture_is_opencvs_demosaic_of_the_same_light(
    footage: Footage, order: str
) -> None:
    samples = rose(footage, order)
    light = (samples.astype(float) - 600).clip(0) / (16383 - 600)
    lit = np.rint(255 * light ** (1 / 2.2)).astype(np.uint8)
    expected = cv2.cvtColor(lit, getattr(cv2, f"COLOR_Bayer{order.upper()}2RGB")).astype(int)

    got = shown(samples, f"bayer_{order}14", **ROSE)

    assert np.abs(got - expected).max() <= 2


@pytest.mark.parametrize("depth", ["10", "10p"])
@pytest.mark.parametrize("width_px", [0, 480])
def test_the_patches_of_a_chart_have_their_colours(
    footage: Footage, depth: str, width_px: int
) -> None:
    picture = shown(
        chart(footage), f"bayer_rggb{depth}",
        width_px=width_px, white_balance="grey_world", gamma=2.2,
    )  # fmt: skip
    scale = picture.shape[1] / 1920

    def patch(name: str) -> tuple[float, float, float]:
        x, y = (round(at * scale) for at in CHART[name])
        red, green, blue = picture[y - 2 : y + 3, x - 2 : x + 3].reshape(-1, 3).mean(0)
        return float(red), float(green), float(blue)

    assert patch("orange")[0] > patch("orange")[1] > patch("orange")[2]
    assert patch("cyan")[2] > patch("cyan")[1] > patch("cyan")[0]
    assert patch("navy")[2] > 1.3 * max(patch("navy")[:2])
    assert patch("green")[1] > 1.1 * max(patch("green")[0], patch("green")[2])
    assert patch("brown")[0] > 1.5 * max(patch("brown")[1:])
    assert patch("yellow")[2] < min(patch("yellow")[:2]) - 30
    assert np.ptp(patch("grey")) < 20
