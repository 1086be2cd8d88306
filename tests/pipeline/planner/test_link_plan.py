"""Streams against links: the paper's board on USB 3.0, unknown needs, what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.forecast import Forecast, LinkUse, PictureStream, pictures
from pipeline.planner.link_plan import doubted, link_plan, refused, unknown
from pipeline.planner.links import LINKS

ORDER = ["fits", "marginal", "does not fit"]


def paper(depth: str, **link: float | str) -> Forecast:
    """Return the streams of the paper's board at 30 Hz."""
    sides = {"context": (2040, 1148), "roi": (4080, 2296)}
    streams = {name: pictures(px, f"bayer_rggb{depth}", 30) for name, px in sides.items()}
    use = LinkUse(streams=tuple(streams.values()), **link)  # type: ignore[arg-type]
    return Forecast(streams=streams, link=use, rate_hz=30)


@pytest.mark.parametrize(
    ("depth", "needed", "verdict"),
    [("8", 351, "fits"), ("10p", 439, "marginal"), ("16", 703, "does not fit")],
)
def test_the_board_of_the_paper_on_usb_3(depth: str, needed: int, verdict: str) -> None:
    found = link_plan("capture", paper(depth, kind="usb3.0"))

    assert found is not None
    assert found.needed_bytes_per_s is not None
    assert round(found.needed_bytes_per_s / 1e6) == needed
    assert found.verdicts["usb3.0"] == verdict
    assert bool(list(refused(found))) == (verdict == "does not fit")
    assert bool(list(doubted(found))) == (verdict == "marginal")


def test_a_refusal_has_the_figures_and_the_rate_that_would_fit() -> None:
    found = link_plan("capture", paper("16", kind="usb3.0"))

    assert found is not None
    assert list(refused(found)) == [
        "capture: link: expected up to 450 MB/s over USB 3.0, got 703: 2040x1148 bayer_rggb16 at "
        "30 Hz + 4080x2296 bayer_rggb16 at 30 Hz; at most 19.2 Hz"
    ]


def test_what_the_device_states_counts_whatever_its_link_would_carry() -> None:
    found = link_plan("capture", paper("10p", carries_bytes_per_s=400e6), "usb3.1")

    assert found is not None
    assert [said.split(",")[0] for said in refused(found)] == [
        "capture: link: expected up to 400 MB/s over the device's link"
    ]


def test_a_compressed_stream_has_no_verdict_and_no_refusal() -> None:
    crossing = PictureStream(size_px=(1920, 1080), pixel_format="MJPG", frame_bytes=None)
    told = Forecast(link=LinkUse(streams=(crossing,)))

    found = link_plan("capture", told, "usb2")

    assert found is not None
    assert set(found.verdicts.values()) == {"not known"}
    assert not list(refused(found))
    assert list(unknown("capture", found, "usb2")) == [
        "capture: link: not known whether 1920x1080 MJPG fits USB 2"
    ]


def test_a_source_without_streams_has_no_link() -> None:
    assert link_plan("capture", Forecast()) is None
    assert list(unknown("capture", None, "")) == []
    assert list(unknown("capture", None, "gige")) == [
        "capture: link: not known whether what it sends fits GigE"
    ]


def test_a_source_that_states_no_link_is_judged_by_its_outputs() -> None:
    told = Forecast(streams={"out": pictures((640, 480), "rgb8", 60)})

    found = link_plan("capture", told, "usb2")

    assert found is not None
    assert not found.crosses
    assert [said.split(":")[1] for said in refused(found)] == [" link"]


@given(needs=st.lists(st.floats(0, 2e9), min_size=2, max_size=2), kind=st.sampled_from(list(LINKS)))
def test_a_larger_need_is_never_judged_better(needs: list[float], kind: str) -> None:
    small, large = sorted(needs)
    link = LINKS[kind]

    assert link.carries_bytes_per_s < link.most_bytes_per_s
    assert ORDER.index(link.verdict(small)) <= ORDER.index(link.verdict(large))
