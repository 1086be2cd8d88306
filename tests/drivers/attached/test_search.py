"""Looking for sensors: a kind that fails, hangs or crashes hides no other."""

import json
import subprocess
import sys
import time

import pytest

from drivers.attached.listing import AttachedSensor, KindFound, Offer
from drivers.attached.report import NOTHING, described, figures_line, listing
from drivers.attached.search import KINDS, Kind, search
from tests.conftest import ROOT

KIND = "tests.drivers.attached.kinds"


def looked(*names: str, limit_s: float = 20.0) -> dict[str, KindFound]:
    kinds = {name: Kind(what=f"{name} ones", look=f"{KIND}:{name}") for name in names}
    return {kind.kind: kind for kind in search(kinds, limit_s=limit_s)}


def test_every_kind_tells_what_it_found_or_why_it_did_not() -> None:
    told = looked(
        "found", "missing", "broken", "crashing", "leaving", "endless", "unfit", "nowhere"
    )

    assert [sensor.name for sensor in told["found"].sensors] == ["test:1", "test:2"]
    assert told["found"].sensors[1].problem == "it is in use"
    assert told["missing"].missing == (
        "test: expected the package nowhere, got none: pip install nowhere"
    )
    assert told["broken"].problem == r"test: the bus \x1b[31m is broken"
    assert [sensor.name for sensor in told["broken"].sensors] == ["test:1"]
    assert told["crashing"].problem == "the library crashed (SIGSEGV)"
    assert told["leaving"].problem == "it ended early, with exit status 7"
    assert told["endless"].problem == "expected answers of at most 1048576 bytes, got more"
    assert told["unfit"].problem.startswith("unfit.sensors.0.")
    assert "has no attribute 'nowhere'" in told["nowhere"].missing


def test_one_that_hangs_costs_its_limit_and_keeps_what_it_told_before() -> None:
    began_s = time.monotonic()

    told = looked("silent", "found", limit_s=3.0)

    assert time.monotonic() - began_s < 30
    assert told["silent"].problem == "no answer within 3 s"
    assert [sensor.name for sensor in told["silent"].sensors] == ["test:1"]
    assert len(told["found"].sensors) == 2


def test_one_that_tells_another_sensor_again_and_again_ends_at_the_limit() -> None:
    began_s = time.monotonic()

    told = looked("dripping", limit_s=3.0)

    assert time.monotonic() - began_s < 30
    assert told["dripping"].problem == "no answer within 3 s"
    assert told["dripping"].sensors


def test_a_list_says_in_one_line_what_was_not_looked_for() -> None:
    lines = list(listing(list(looked("missing", "broken").values())))

    assert lines[0] == "test:1  a sensor"
    assert (
        "not looked for: missing ones: test: expected the package nowhere, got none: pip "
        in (lines[-2])
    )
    assert lines[-1] == r"not found out: broken ones: test: the bus \x1b[31m is broken"
    assert list(listing([KindFound(kind="usb", what="boards")])) == [NOTHING]


def test_a_sensor_is_shown_with_what_it_can_do() -> None:
    sensor = AttachedSensor(
        name="usb:S1", title="a board", where="usb 1.4", modes=("live",), context_px=(480, 270),
        offers=(
            Offer(pixel_format="rgb8", size_px=(1920, 1080), rates_hz=(1, 29.97), ranged=True),
            Offer(pixel_format="bayer_rggb8", size_px=(1920, 1080), rates_hz=(1, 29.97),
                  ranged=True),
            Offer(pixel_format="MJPG", size_px=(640, 480), rates_hz=(30, 15)),
            Offer(pixel_format="YUYV"),
        ),
        roi_sizes_px=((480, 270), (960, 540)), foveates=True, foveation="from one exposure",
        run="fovea run tracking --source usb", problem="no permission",
        remedy="fovea sensors rules",
    )  # fmt: skip

    assert list(described(sensor)) == [
        "usb:S1  a board (usb 1.4)",
        "  problem   no permission -> fovea sensors rules",
        "  sends     1920x1080 at 1 to 29.97 Hz as rgb8, bayer_rggb8",
        "  sends     640x480 at 30, 15 Hz as MJPG",
        "  sends     as YUYV",
        "  context   480x270",
        "  ROI       480x270, 960x540",
        "  modes     live",
        "  foveates  yes: from one exposure",
        "  run       fovea run tracking --source usb",
    ]


def test_a_sensor_of_many_offers_stays_short() -> None:
    offers = tuple(
        Offer(pixel_format="MJPG", size_px=(width, 480)) for width in range(640, 1640, 10)
    )

    lines = list(described(AttachedSensor(name="a", title="b", offers=offers)))

    assert len(lines) == 14
    assert lines[-1].strip() == "and 88 more, see --json"


def test_figures_are_told_on_one_line() -> None:
    figures = {"rates_hz": (0.1, 1000.0), "pixel_formats": ["rgb8", "grey8"], "told": 2}

    assert figures_line(figures) == "rates_hz 0.1 to 1000, pixel_formats rgb8 grey8, told 2"


WITHOUT_EXTRAS = """
import sys
from importlib.abc import MetaPathFinder

class Nowhere(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("usb", "gi"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nowhere())
"""


def without_extras(code: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", WITHOUT_EXTRAS + code]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(
    ("look", "said"),
    [
        ("boards", "expected the package pyusb, got none: pip install 'fovea[usb]'"),
        ("industrial", "expected the package PyGObject, got none: apt-get install gir1.2-aravis"),
    ],
)
def test_a_missing_extra_is_told_with_the_command_that_installs_it(look: str, said: str) -> None:
    done = without_extras(
        f"from drivers.attached.child import main; main('drivers.attached.{look}:look', '9')"
    )

    first, last = map(json.loads, done.stdout.splitlines())
    assert first["family"] == "InstallError"
    assert said in first["failed"]
    assert last == {"ended": True}


def test_the_command_the_rule_and_the_doctor_need_no_extra() -> None:
    done = without_extras(
        "from drivers.attached.command import sensors_command\n"
        "from drivers.attached import diagnosis, subject, trial\n"
        "sensors_command(['rules'])"
    )

    assert done.returncode == 0, done.stderr
    assert 'ATTR{idVendor}=="1209"' in done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_looked_for_here(kind: str) -> None:
    (found,) = search({kind: KINDS[kind]}, limit_s=60.0)

    assert (found.kind, found.what) == (kind, KINDS[kind].what)
    if found.missing:
        assert "got none" in found.missing
        assert "install" in found.missing
