"""The table of pixel formats: names, sizes, orders."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import MessageError
from pipeline.messages import Frame
from pipeline.pixel_formats import BY_CODE, BY_PFNC, FORMATS, pixel_format
from pipeline.testing import header

ALL = st.sampled_from(list(FORMATS.values()))
BAYER = [form for form in FORMATS.values() if form.order]


def test_names_and_codes_are_those_of_the_naming_convention():
    assert BY_PFNC["BayerRG12p"].name == "bayer_rggb12p"
    assert BY_PFNC["BayerGB10"].name == "bayer_gbrg10"
    assert BY_PFNC["Mono12p"].name == "grey12p"
    assert BY_CODE[0x010A0052].pfnc == "BayerBG10p"
    assert len(BY_CODE) == len(BY_PFNC) == len(FORMATS)
    for form in FORMATS.values():  # a code holds the bits of a pixel, PFNC 2.0 section 5
        held = (form.code >> 16) & 0xFF
        assert held == (form.bits if form.packed else 8 * form.row_bytes(1))


@given(form=ALL, width=st.integers(1, 5000), height=st.integers(1, 5000))
def test_the_size_of_a_picture_follows_from_its_shape(form, width, height):
    shape = form.shape((width, height))

    assert form.size_px(shape) == (width, height)
    if form.packed:
        assert 0 <= shape[1] * 8 - width * form.bits < 8


def test_a_frame_tells_the_size_of_its_picture_not_of_its_bytes():
    pixels = np.zeros((1148, 3060), np.uint8)

    raw = Frame(header=header(), pixels=pixels, pixel_format="bayer_rggb12p")
    own = Frame(header=header(), pixels=pixels, pixel_format="of my own")

    assert (raw.size_px, raw.packed) == ((2040, 1148), True)
    assert (own.size_px, own.packed) == ((3060, 1148), False)
    assert Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8)).size_px == (0, 0)


@given(form=st.sampled_from(BAYER), right=st.integers(0, 9), down=st.integers(0, 9))
def test_a_cut_has_the_order_that_its_first_pixel_begins(form, right, down):
    whole = np.array(list(form.order)).reshape(2, 2)
    mosaic = np.tile(whole, (6, 6))

    order = form.shifted(right, down).order

    assert "".join(mosaic[down : down + 2, right : right + 2].ravel()) == order
    assert form.shifted(right, down).bits == form.bits


@pytest.mark.parametrize(
    ("name", "pixels", "named"),
    [
        ("bayer_rggb12p", np.zeros((4, 6), np.uint16), r"expected uint8 \(h, row_bytes\) as bayer"),
        ("bayer_rggb12", np.zeros((4, 6), np.uint8), r"expected uint16 \(h, w\) as bayer_rggb12 "),
        ("rgb8", np.zeros((4, 6), np.uint8), r"expected uint8 \(h, w, 3\) as rgb8 has it, got"),
        ("grey8", np.zeros((4, 6, 3), np.uint8), r"where: expected uint8 \(h, w\) as grey8"),
    ],
)
def test_pixels_that_are_not_of_their_format_are_refused(name, pixels, named):
    with pytest.raises(MessageError, match=named):
        FORMATS[name].check("where", pixels)


def test_an_unknown_name_is_refused_and_a_foreign_one_translated():
    with pytest.raises(MessageError, match=r"frame: expected pixels as rgb8, .* got yuv422"):
        pixel_format("yuv422", "frame")
    with pytest.raises(MessageError, match="got BayerGR10p, here called bayer_grbg10p"):
        pixel_format("BayerGR10p", "frame")
