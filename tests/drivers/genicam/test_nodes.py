"""Descriptions of cameras: what is read, and what is refused in one sentence."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.fuzz.descriptions import mutated
from drivers.genicam.formats import entry_of, offered
from drivers.genicam.foveation import foveation
from drivers.genicam.nodes import parse_nodes
from drivers.genicam.values import NodeValues
from drivers.genicam.vetting import vetted_nodes
from pipeline.errors import DriverError
from tests.drivers.genicam import description as xml
from tests.drivers.genicam.virtual_camera import Nature, describe

SOUND = describe(Nature(sets=8))


def test_nodes_are_found_by_name_with_their_fields_and_entries() -> None:
    found = parse_nodes(SOUND)

    width = found.get("Width")
    assert width is not None
    assert (found.vendor, found.model) == ("Fovea", "Virtual")
    assert (width.kind, width.text("Min"), width.text("Inc")) == ("Integer", "4", "4")
    assert list(width.links("pValue")) == ["WidthRegister"]
    source = found.get("TriggerSource")
    assert source is not None
    assert source.entries == {"Line0": 0, "Software": 1}
    assert found.get("Nothing") is None


def test_an_entry_is_no_feature_of_its_name() -> None:
    found = parse_nodes(xml.whole([xml.choice("ChunkSelector", 0, [("OffsetX", 3)])]))

    assert found.get("OffsetX") is None


def test_pixel_formats_are_known_by_their_code() -> None:
    formats = [("RGB8Packed", 0x02180014), ("YUV422", 0x0210001F), ("BayerRG8", 0x01080009)]
    found = parse_nodes(xml.whole([xml.choice("PixelFormat", 0, formats)]))

    assert offered(found) == ("RGB8", "BayerRG8")
    assert entry_of(found, "RGB8") == "RGB8Packed"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"", "expected well-formed XML, got no element found: line 1, column 0"),
        (b"<a/>", "expected a RegisterDescription, got <a>"),
        (b"not XML", "expected well-formed XML, got syntax error: line 1, column 0"),
        (SOUND[: len(SOUND) // 2], "expected well-formed XML, got"),
        (b"<!DOCTYPE a><RegisterDescription/>", "expected no document type, got one"),
        (b"<?xml version='1.0' encoding='klingon'?><a/>", "expected"),
        (b"<RegisterDescription>" + b"<Group>" * 99, "expected at most 16 levels, got more"),
        (xml.whole([xml.integer("A" * 70_000, 0, 0, 1)]), "texts of at most 65536 characters"),
        (b" " * (17 << 20), "expected at most 16 MB, got 17825792 bytes"),
    ],
)
def test_what_is_no_description_is_refused_in_a_sentence(text: bytes, sentence: str) -> None:
    with pytest.raises(DriverError) as caught:
        vetted_nodes(text)

    assert str(caught.value).startswith("description of the camera: expected ")
    assert sentence in str(caught.value)
    assert len(str(caught.value)) < 300


def ring(*names: str) -> list[str]:
    turned = (*names[1:], names[0])
    return [xml.formula(name, "V", V=next_) for name, next_ in zip(names, turned, strict=True)]


@pytest.mark.parametrize("names", [("A",), ("A", "B"), ("A", "B", "C", "D")])
def test_values_in_a_ring_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(DriverError, match=r"expected values that end in a register, got \w in a"):
        vetted_nodes(xml.whole(ring(*names)))


def test_limits_that_refer_to_one_another_are_no_ring() -> None:
    nodes = [
        xml.integer("Width", 0, 1, "WidthMost"),
        xml.integer("OffsetX", 4, 0, "OffsetMost"),
        xml.formula("WidthMost", "100-O", O="OffsetX"),
        xml.formula("OffsetMost", "100-W", W="Width"),
    ]

    assert vetted_nodes(xml.whole(nodes)).get("Width") is not None


def test_a_long_chain_is_refused_and_a_wide_one_takes_no_time() -> None:
    chain = [xml.formula(f"N{i}", "V", V=f"N{i + 1}") for i in range(300)]
    wide = [xml.formula(f"W{i}", "1", **{f"V{j}": f"W{j}" for j in range(i)}) for i in range(150)]

    with pytest.raises(DriverError, match="expected chains of at most 256 nodes"):
        vetted_nodes(xml.whole(chain))
    began = time.process_time()
    vetted_nodes(xml.whole(wide))
    assert time.process_time() - began < 2


def expressions(count: int, text: str) -> bytes:
    """A width whose expressions E0, E1, … each mention the next one by `text`."""
    told = "".join(
        f'<Expression Name="E{k}">{text.format(next=f"E{k + 1}")}</Expression>'
        for k in range(count)
    )
    last = f'<Expression Name="E{count}">1</Expression><Formula>E0</Formula>'
    return xml.whole([f'<IntSwissKnife Name="Width">{told}{last}</IntSwissKnife>'])


@pytest.mark.parametrize(
    ("count", "text", "expected"),
    [
        (20, "{next}+{next}", 2**20),
        (40, "{next}", None),  # deeper than what is followed
        (600, "{next}", None),
        (3, "{next}+E0", None),  # a ring
    ],
)
def test_an_expression_is_computed_once_however_often_it_is_mentioned(
    count: int, text: str, expected: int | None
) -> None:
    began = time.process_time()

    assert NodeValues(vetted_nodes(expressions(count, text))).value("Width") == expected
    assert time.process_time() - began < 1


@pytest.mark.parametrize("length", ["-1", "0", "", "99999999999", "1e3", "four"])
def test_a_register_of_impossible_length_is_refused(length: str) -> None:
    text = SOUND.replace(b"<Length>4</Length>", f"<Length>{length}</Length>".encode(), 1)

    with pytest.raises(DriverError, match=r"Register of 1 to 65536 bytes, got"):
        vetted_nodes(text)


def judged(text: bytes) -> str:
    """A verdict or a sentence; anything else is a failure of the test."""
    try:
        found = foveation(vetted_nodes(text))
    except DriverError as error:
        return str(error)
    return found.reason or found.means


def test_damaged_descriptions_end_in_a_verdict_or_a_sentence() -> None:
    told = [judged(mutated(SOUND, seed)) for seed in range(400)]

    assert all(told)
    assert len(set(told)) > 20
    assert not any("\n" in sentence or len(sentence) > 400 for sentence in told)


@pytest.mark.slow
def test_ten_thousand_damaged_descriptions_end_in_a_verdict_or_a_sentence() -> None:
    assert all(judged(mutated(SOUND, seed)) for seed in range(10_000))


@given(st.binary(max_size=300))
def test_any_bytes_end_in_a_verdict_or_a_sentence(text: bytes) -> None:
    assert judged(text)
    assert judged(SOUND[:800] + text + SOUND[800:])
