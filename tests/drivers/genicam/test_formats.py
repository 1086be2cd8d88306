"""Pixel formats of cameras: which ones are read, and their bytes as numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.formats import (
    BY_CODE,
    BY_NAME,
    CAMERA_FORMATS,
    CameraFormat,
    copy_frame,
    entry_of,
    offered,
    picture,
    unpack,
)
from drivers.genicam.foveation import Foveation
from drivers.genicam.nodes import parse_nodes
from drivers.genicam.rig import layout
from tests.drivers.genicam import description as xml
from tests.drivers.packing import numbers, packed
from tests.shared_data import Footage

PACKS = [form for form in CAMERA_FORMATS if form.packs]
REAL = (  # camera, a format that is no longer left out, what the camera calls it
    ("Blackfly_S_BFS-U3-16S2M", "BayerRG10p", "BayerRG10p"),
    ("Blackfly_S_BFS-U3-63S4M", "Mono10Packed", "Mono10Packed"),
    ("Chameleon3_CM3-U3-13Y3M", "BayerGB12Packed", "BayerGB12Packed"),
    ("Flea3_FL3-U3-13S2M", "Mono12p", "Mono12p"),
    ("MV-CA013-A0UM", "BayerBG10Packed", "BayerBG10Packed"),
    ("MV-CA013-A0UM", "BGR8", "BGR8Packed"),
    ("Mako_U-029B", "Mono14", "Mono14"),
    ("UI322xCP-M", "BayerRG12", "BayerRG12"),
)


def sent(samples: np.ndarray, form: CameraFormat, padding: int = 0) -> np.ndarray:
    """The bytes of a frame, bit by bit."""
    if form.paired:
        rows = np.array([[byte for pair in row.reshape(-1, 2) for byte in three(*map(int, pair),
                          form.form.bits)] for row in samples], np.uint8)  # fmt: skip
    else:
        rows = packed(samples, form.form)
    padded = np.pad(rows.view(np.uint8), ((0, 0), (0, padding)), constant_values=0xEE)
    return np.ascontiguousarray(padded).reshape(-1)


def three(first: int, second: int, bits: int) -> tuple[int, int, int]:
    low = bits - 8
    middle = first % (1 << low) | second % (1 << low) << 4
    return first >> low, middle, second >> low


def test_no_two_formats_share_a_name_or_a_code() -> None:
    assert len(BY_CODE) == len(BY_NAME) == len(CAMERA_FORMATS) == 47
    assert all(form.code >> 16 & 0xFF == 12 for form in CAMERA_FORMATS if form.paired)


@pytest.mark.parametrize("form", PACKS, ids=lambda form: form.name)
@given(
    groups=st.integers(1, 12), height=st.integers(1, 70), padding=st.integers(0, 5),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_packed_frames_are_unpacked_to_their_samples(
    form: CameraFormat, groups: int, height: int, padding: int, seed: int
) -> None:
    width = groups * form.multiple_px
    samples = np.random.default_rng(seed).integers(0, form.form.white + 1, (height, width))
    out = np.full((height, width), 0xAAAA, np.uint16)

    seen = picture(
        sent(samples, form, padding), width_px=width, height_px=height, padding=padding, form=form
    )
    assert seen is not None
    unpack(seen, form, out)

    assert np.array_equal(out, samples)


@pytest.mark.parametrize("form", CAMERA_FORMATS, ids=lambda form: form.name)
def test_a_frame_of_the_graph_holds_the_samples_that_were_sent(form: CameraFormat) -> None:
    width, height = 8, 6
    shape = (height, width, 3) if form.form.channels == 3 else (height, width)
    samples = np.random.default_rng(5).integers(0, form.form.white + 1, shape)
    memory = samples.astype(np.uint8).reshape(-1) if len(shape) == 3 else sent(samples, form)
    out = np.empty(form.form.shape((width, height)), form.form.dtype)

    seen = picture(memory.view(np.uint8), width_px=width, height_px=height, padding=0, form=form)
    assert seen is not None
    copy_frame(seen, form, out)

    assert np.array_equal(out if len(shape) == 3 else numbers(out, form.form), samples)
    assert np.shares_memory(seen, memory)


@pytest.mark.parametrize("form", CAMERA_FORMATS, ids=lambda form: form.name)
def test_a_frame_that_lacks_a_byte_or_ends_within_one_is_none(form: CameraFormat) -> None:
    memory = np.zeros(form.row_bytes(8) * 6, np.uint8)

    def whole(memory: np.ndarray, **sizes: int) -> bool:
        given = {"width_px": 8, "height_px": 6, "padding": 0, **sizes}
        return picture(memory, form=form, **given) is not None

    assert whole(memory)
    assert not whole(memory[:-1])
    assert not whole(memory, padding=1)
    assert not any(whole(memory, **{side: 0}) for side in ("width_px", "height_px"))
    assert not whole(memory, padding=-1)
    assert whole(memory, width_px=7) == (form.multiple_px == 1)


def test_the_low_bits_of_two_samples_share_the_byte_in_the_middle() -> None:
    for name, bytes_, wanted in (
        ("Mono12Packed", (0xAB, 0x1C, 0xDE), (0xABC, 0xDE1)),
        ("Mono10Packed", (0xFF, 0x12, 0x01), (0x3FE, 0x005)),
    ):
        out = np.zeros((1, 2), np.uint16)
        unpack(np.array([bytes_], np.uint8), BY_NAME[name], out)
        assert tuple(out[0]) == wanted


def test_deep_formats_are_offered_after_those_of_eight_bit() -> None:
    stated = [("Mono12Packed", 0x010C0006), ("BayerRG10p", 0x010A0058), ("Mono8", 0x01080001),
              ("YUV422Packed", 0x0210001F), ("BayerRG12", 0x01100011)]  # fmt: skip
    found = parse_nodes(xml.whole([xml.choice("PixelFormat", 0, stated)]))

    assert offered(found) == ("Mono8", "BayerRG12", "Mono12Packed", "BayerRG10p")


def test_context_and_roi_of_a_packed_format_have_whole_bytes_in_a_row() -> None:
    can = Foveation(
        means="writes", reduction="Binning", factors=(2, 4), field_px=(660, 480),
        size_step_px=(2, 2), offset_step_px=(2, 2),
    )  # fmt: skip

    widths = [layout("camera", can, 2, mosaic=True, multiple_px=wide).size_px[0] for wide in (1, 4)]

    assert widths == [330, 328]


@pytest.mark.footage
@pytest.mark.parametrize(("camera", "name", "own"), REAL)
def test_real_cameras_state_formats_that_can_be_read(
    camera: str, name: str, own: str, footage: Footage
) -> None:
    found = parse_nodes(footage.data(f"genicam/{camera}.xml").read_bytes())

    assert name in offered(found)
    assert entry_of(found, name) == own
