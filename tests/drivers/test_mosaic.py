"""Raw pixels as a sensor sends them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mosaic import to_mosaic, write_samples
from pipeline.pixel_formats import FORMATS, ORDERS
from tests.drivers.packing import packed

PACKED = [form for form in FORMATS.values() if form.packed]


@given(
    form=st.sampled_from(PACKED),
    width=st.integers(1, 41),
    height=st.integers(1, 70),
    seed=st.integers(0, 2**32 - 1),
)
def test_packing_is_that_of_the_standard_bit_by_bit(form, width, height, seed):
    samples = np.random.default_rng(seed).integers(0, form.white + 1, (height, width))
    out = np.full(form.shape((width, height)), 0xAA, np.uint8)

    write_samples(samples.astype(np.uint16), form, out)

    assert np.array_equal(out, packed(samples, form))


@pytest.mark.parametrize("order", ORDERS)
def test_every_site_keeps_the_colour_that_its_order_names(order):
    image = np.random.default_rng(1).integers(0, 256, (7, 9, 3), np.uint8)
    mosaic = np.empty((7, 9), np.uint8)

    to_mosaic(image, order, mosaic)

    for y in range(7):
        for x in range(9):
            colour = order[y % 2 * 2 + x % 2]
            assert mosaic[y, x] == image[y, x, "rgb".index(colour)]
