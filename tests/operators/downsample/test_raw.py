"""Raw frames become RGB: unpacking, binning, levels, colours."""

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.samples import STRIP, Samples
from operators.downsample import Downsample, DownsampleSettings
from operators.downsample.white_balance import Balance
from pipeline import codec
from pipeline.errors import MessageError, SettingsError
from pipeline.messages import Frame
from pipeline.pixel_formats import FORMATS, ORDERS, PixelFormat
from pipeline.testing import drive, header
from tests.drivers.packing import packed

BAYER = [form for form in FORMATS.values() if form.order]


def raw(samples: NDArray[Any], form: PixelFormat, seq: int = 0) -> Frame:
    height, width = samples.shape
    window = (0, 0, 2 * width, 2 * height)
    pixels = packed(samples, form)
    return Frame(header=header(seq), pixels=pixels, pixel_format=form.name, window=window)


def random(form: PixelFormat, height: int, width: int, seed: int = 0) -> NDArray[Any]:
    return np.random.default_rng(seed).integers(0, form.white + 1, (height, width))


def developed(frame: Frame, **settings: Any) -> NDArray[Any]:
    (got,) = drive(Downsample, [frame], settings)
    assert (got.pixel_format, got.window) == ("rgb8", frame.window)
    return got.pixels.astype(np.float64)


def sites(samples: NDArray[Any], order: str) -> NDArray[np.float64]:
    """Superpixels (h / 2, w / 2, 3) of a mosaic, the greens averaged."""
    corners = [samples[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    parts = [[c for c, site in zip(corners, order, strict=True) if site == one] for one in "rgb"]
    return np.stack([np.mean(part, axis=0) for part in parts], -1)


def area(picture: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Exact means of the cells of a grid, edges cut through pixels."""
    for axis, short in ((0, height), (1, width)):
        edges = np.arange(short + 1) * picture.shape[axis] / short
        sums = np.concatenate([np.zeros_like(picture.take([0], axis)), picture.cumsum(axis)], axis)
        whole = np.minimum(edges.astype(int), picture.shape[axis] - 1)
        part = (edges - whole).reshape([-1 if a == axis else 1 for a in range(3)])
        at = sums.take(whole, axis) + part * picture.take(whole, axis)
        picture = np.diff(at, axis=axis) * short / picture.shape[axis]
    return picture


@given(
    form=st.sampled_from([form for form in FORMATS.values() if form.packed]),
    width=st.integers(1, 61),
    height=st.integers(1, STRIP),
    seed=st.integers(0, 2**32 - 1),
)
def test_unpacking_gives_every_sample_back(form, width, height, seed):
    samples = random(form, height, width, seed)
    read = Samples(form, width)
    read(np.full(form.shape((width, STRIP)), 0xFF, np.uint8))  # nothing of it remains

    assert np.array_equal(read(packed(samples, form)), samples)


@pytest.mark.parametrize("form", BAYER, ids=lambda form: form.name)
def test_at_full_size_every_format_is_demosaiced_as_opencv_does(form):
    samples = random(form, 70, 46, seed=2)
    plain = np.rint(samples * 255 / form.white).astype(np.uint8)
    expected = cv2.cvtColor(plain, getattr(cv2, f"COLOR_Bayer{form.order.upper()}2RGB"))

    got = developed(raw(samples, form))

    assert np.abs(got - expected).max() <= 1


@pytest.mark.parametrize("form", BAYER, ids=lambda form: form.name)
@pytest.mark.parametrize("width_px", [46, 32, 23, 12])
def test_a_smaller_picture_is_the_mean_of_each_colour_in_each_cell(form, width_px):
    samples = random(form, 140, 92, seed=3)
    height_px = round(140 * width_px / 92)

    got = developed(raw(samples, form), width_px=width_px)

    exact = area(sites(samples, form.order), height_px, width_px) * 255 / form.white
    assert got.shape == (height_px, width_px, 3)
    assert np.abs(got - exact).max() <= 0.75


def test_where_blocks_are_averaged_first_only_the_edges_of_cells_soften():
    form = FORMATS["bayer_gbrg12p"]
    detail = cv2.resize(random(form, 18, 32, seed=4).astype(np.float32), (1024, 576))
    samples = detail.clip(0, form.white).astype(int)

    got = developed(raw(samples, form), width_px=52)  # blocks of 2x2 superpixels, 4.9 in a cell

    exact = area(sites(samples, form.order), 29, 52) * 255 / form.white
    assert np.abs(got - exact).max() <= 4
    assert np.abs(got - exact).mean() <= 0.6


@pytest.mark.parametrize("size", [(61, 44), (60, 45), (61, 45)])
def test_a_mosaic_of_odd_sides_is_shrunk_all_the_same(size):
    width, height = size
    flat = np.zeros((height, width), int)
    flat[0::2, 0::2], flat[1::2, 1::2] = 200, 100  # red and blue of rggb

    got = developed(raw(flat, FORMATS["bayer_rggb8"]), width_px=15)

    assert got[2:-2, 2:-2].reshape(-1, 3).mean(0) == pytest.approx([200, 0, 100], abs=2)


@pytest.mark.parametrize("width_px", [0, 24])
@pytest.mark.parametrize("name", ["bayer_rggb8", "bayer_bggr10p", "bayer_grbg12", "bayer_gbrg16"])
@pytest.mark.parametrize("gamma", [1.0, 2.2, 0.6])
def test_a_flat_field_has_the_light_that_levels_gains_and_gamma_give(name, width_px, gamma):
    form = FORMATS[name]
    black, gains = form.white // 16, (1.5, 1.0, 0.75)
    for share in (0.0, 0.02, 0.1, 0.4, 0.6, 1.0):
        value = round(black + share * (form.white - black))
        got = developed(
            raw(np.full((64, 96), value), form),
            width_px=width_px, black_level=black, gains=gains, gamma=gamma,
        )  # fmt: skip

        light = np.clip((value - black) / (form.white - black) * np.array(gains), 0, 1)
        assert np.abs(got - 255 * light ** (1 / gamma)).max() <= 1.5


def test_below_the_black_level_is_black_and_above_the_white_level_white():
    form = FORMATS["bayer_rggb12p"]
    samples = np.full((40, 40), 100)
    samples[:, 20:] = 4000

    got = developed(raw(samples, form), black_level=300, white_level=3500)

    assert (got[:, :18] == 0).all()
    assert (got[:, 22:] == 255).all()


def test_noise_around_black_averages_out_before_it_is_cut_off():
    form = FORMATS["bayer_rggb10"]
    noise = np.random.default_rng(1).normal(64, 30, (400, 400)).clip(0, 1023).round()

    small = developed(raw(noise.astype(int), form), width_px=20, black_level=64)

    assert small.mean() < 1


@pytest.mark.parametrize("name", ["grey8", "grey10", "grey10p", "grey12p", "grey14", "grey16"])
def test_grey_of_any_depth_becomes_rgb(name):
    form = FORMATS[name]
    samples = random(form, 50, 36, seed=5)

    whole = developed(raw(samples, form))
    small = developed(raw(samples, form), width_px=9, black_level=3)

    assert np.abs(whole - samples[..., None] * 255 / form.white).max() <= 0.5 + 1e-4
    assert small.shape == (12, 9, 3)
    assert (np.ptp(small, axis=2) == 0).all()


@pytest.mark.parametrize("name", ["bayer_rggb12p", "bayer_rggb16", "grey8"])
def test_an_empty_raw_picture_becomes_an_empty_rgb_one(name):
    empty = np.empty((0, 0), FORMATS[name].dtype)
    frame = Frame(header=header(), pixels=empty, pixel_format=name)

    assert developed(frame, width_px=12).shape == (0, 0, 3)


def test_bgr_is_turned_and_shrunk():
    pixels = np.zeros((20, 30, 3), np.uint8)
    pixels[..., 0] = 200  # blue
    frame = Frame(header=header(), pixels=pixels, pixel_format="bgr8", window=(0, 0, 30, 20))

    assert (developed(frame) == [0, 0, 200]).all()
    assert (developed(frame, width_px=10) == [0, 0, 200]).all()


def under(light: tuple[float, float, float], seq: int, form: PixelFormat) -> Frame:
    """A grey scene with detail, lit by a light of that colour."""
    grey = np.random.default_rng(7).uniform(0.1, 0.6, (60, 80))
    colour = np.array([light["rgb".index(site)] for site in form.order]).reshape(2, 2)
    numbers = 64 + grey * np.tile(colour, (30, 40)) * (form.white - 64)
    return raw(numbers.round().astype(int), form, seq)


@pytest.mark.parametrize("order", ORDERS)
def test_a_grey_scene_is_grey_under_a_coloured_light(order):
    form = FORMATS[f"bayer_{order}12p"]

    got = developed(
        under((0.5, 1.0, 0.7), 0, form), white_balance="grey_world", black_level=64, width_px=20
    )

    red, green, blue = got.mean((0, 1))
    assert (red, blue) == pytest.approx((green, green), rel=0.03)


def test_the_balance_follows_slowly_and_survives_a_swap():
    form, settings = FORMATS["bayer_rggb12"], {"white_balance": "grey_world", "black_level": 64}
    first = Downsample(DownsampleSettings(**settings, adaptation=0.25))
    first.open()
    first.on_frame(under((0.5, 1.0, 1.0), 0, form))
    before = first.state()
    first.on_frame(under((1.0, 1.0, 1.0), 1, form))
    second = Downsample(DownsampleSettings(**settings, adaptation=0.25))
    second.open()
    second.restore(codec.loads(Balance, codec.dumps(first.state())))

    assert before.gains == pytest.approx((2, 1, 1), rel=0.05)
    assert first.state().gains[0] == pytest.approx(2**0.75, rel=0.05)
    assert second.state() == first.state()
    first.on_stream(header())
    assert first.state().frames == 0


def test_an_roi_takes_the_balance_of_its_reference_and_not_its_own():
    form = FORMATS["bayer_rggb12"]
    subject = Downsample(DownsampleSettings(white_balance="reference", black_level=64))
    subject.open()
    grass = under((0.3, 1.0, 0.2), 1, form)

    subject.on_reference(under((0.5, 1.0, 0.8), 0, form))
    shown = subject.on_frame(grass).pixels.reshape(-1, 3).mean(0)

    assert subject.state().frames == 1
    assert shown[0] / shown[1] == pytest.approx(0.3 / 0.5, rel=0.06)
    assert shown[2] / shown[1] == pytest.approx(0.2 / 0.8, rel=0.06)


@pytest.mark.parametrize("value", [0, 64, 4095])
def test_a_picture_without_light_or_all_full_tells_nothing_of_the_colour(value):
    form = FORMATS["bayer_rggb12"]
    subject = Downsample(DownsampleSettings(white_balance="grey_world", black_level=64))
    subject.open()

    subject.on_frame(raw(np.full((40, 40), value), form))

    assert subject.state().frames == 0


def test_levels_may_change_while_it_runs():
    frame = raw(np.full((40, 40), 1000), FORMATS["bayer_rggb12"])
    subject = Downsample(DownsampleSettings())
    subject.open()
    before = subject.on_frame(frame).pixels.mean()

    subject.on_settings(DownsampleSettings(black_level=1000))

    assert before > 50
    assert subject.on_frame(frame).pixels.max() == 0


@pytest.mark.parametrize(
    ("pixels", "name", "settings", "named"),
    [
        (np.zeros((2, 9), np.uint8), "bayer_rggb8", {}, "a mosaic of at least 3x3, got 9x2"),
        (np.zeros((8, 8), np.uint8), "bayer_rggb12", {}, r"frame: expected uint16 \(h, w\)"),
        (np.zeros((8, 8), np.uint8), "bayer_rggb8", {"black_level": 255}, r"0..255 of bayer_rggb8"),
        (np.zeros((8, 8), np.uint8), "BayerRG8", {}, "got BayerRG8, here called bayer_rggb8"),
    ],
)
def test_a_frame_that_is_not_what_it_says_is_refused(pixels, name, settings, named):
    frame = Frame(header=header(), pixels=pixels, pixel_format=name)

    with pytest.raises(MessageError, match=named):
        drive(Downsample, [frame], settings)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"black_level": -1}, "black_level: must be at least 0, got -1"),
        ({"black_level": 9, "white_level": 9}, "white_level: expected above the black level 9"),
        ({"gains": (1.0, 0.0, 1.0)}, "gains: expected above 0 to 64, got 0.0"),
        ({"adaptation": 0.0}, "adaptation: expected above 0 to 1, got 0.0"),
        ({"gamma": 0.0}, "gamma: expected 0.1 to 10, got 0.0"),
    ],
)
def test_settings_out_of_range_are_refused(values, named):
    with pytest.raises(SettingsError, match=named):
        DownsampleSettings(**values)


def test_a_reference_that_is_not_connected_is_refused_before_the_start():
    settings = DownsampleSettings(white_balance="reference")

    with pytest.raises(SettingsError, match="expected the input reference connected, got none"):
        Downsample.advise(settings, {"frame": object()})
    assert not list(Downsample.advise(settings, {"frame": object(), "reference": object()}))
