"""What each kind of sensor tells of itself: boards, industrial cameras, webcams, permissions."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.attached import boards, webcams
from drivers.attached.permissions import hidden_cameras, usb_devices
from drivers.attached.rules import PLACE, rules
from drivers.genicam.discovery import AttachedCamera
from drivers.genicam.foveation import foveation
from drivers.usb.link import Link, attached
from drivers.virtual_board import VirtualBackend, VirtualBoardSettings
from tests.drivers.cameras.test_v4l2_device import DEVICE, device, run
from tests.drivers.usb.boards import SQUARE, backend

__all__ = ["device"]  # the fixture
LISTED = """
import json, sys
from drivers.attached.webcams import look
print(json.dumps(list(look(sys.argv[1]))))
"""


def test_a_board_tells_its_sizes_rates_formats_and_modes() -> None:
    profile = VirtualBackend(VirtualBoardSettings(profile="paper-prototype", scene=SQUARE))

    (found,) = boards.look(profile)

    assert (found["name"], found["foveates"], found["problem"]) == ("usb:V0001", True, "")
    assert found["title"] == "virtual dual-stream board, firmware 1.0"
    assert (found["context_px"], found["roi_sizes_px"]) == (
        (2040, 1148), ((4080, 2296), (8160, 4592)),
    )  # fmt: skip
    assert found["modes"] == ("record (bursts of 105 frames, preview at 7.5 Hz)",)
    assert {"pixel_format": "rgb8", "size_px": (16320, 9184), "rates_hz": (30.0, 30.0),
            "ranged": True} in found["offers"]  # fmt: skip
    assert found["run"] == (
        "fovea run tracking --source usb --set capture.serial=V0001 --set capture.mode=record"
    )


def test_a_board_in_use_is_listed_with_the_reason_and_left_alone() -> None:
    bus = backend()
    held = Link(attached(bus)[0], in_flight=1)

    (found,) = boards.look(bus)
    held.close()
    (free,) = boards.look(bus)

    assert "cannot be opened: in use by another process" in found["problem"]
    assert (found["offers"], free["problem"]) == ((), "")


@pytest.mark.parametrize(("profile", "records"), [("paper-prototype", True), ("ideal", False)])
def test_a_board_without_a_live_mode_is_known_to_record(profile: str, records: bool) -> None:
    bus = backend(profile=profile)
    (board,) = attached(bus)

    assert boards.only_records(board.serial, bus) is records
    assert boards.only_records("another", bus) is False


def test_no_board_is_no_error() -> None:
    class Empty(VirtualBackend):
        def enumerate_devices(self) -> Iterator[int]:
            return iter(())

    assert list(boards.look(Empty(VirtualBoardSettings(scene=SQUARE)))) == []


def test_an_industrial_camera_tells_whether_it_foveates_and_why_not() -> None:
    from bench.fuzz.descriptions import SMALL
    from drivers.attached.industrial import described
    from drivers.genicam.nodes import parse_nodes

    camera = AttachedCamera(
        id="Fovea-Small-1", vendor="Fovea", model="Small", serial="1", protocol="USB3Vision",
        address="1.2", field_px=(640, 480), pixel_formats=("Mono8", "BayerRG10p"),
        rates_hz=(0.5, 60.0), foveation=foveation(parse_nodes(SMALL)),
    )  # fmt: skip
    locked = SMALL.replace(b'Name="OffsetX">', b'Name="OffsetX"><pIsLocked>One</pIsLocked>')
    locked = locked.replace(b"<Port ", b'<Integer Name="One"><Value>1</Value></Integer><Port ')

    found = described(camera)
    plain = described(replace(camera, foveation=foveation(parse_nodes(locked))))

    assert found.name == "genicam:Fovea-Small-1"
    assert (found.foveates, found.modes) == (True, ("plain", "foveated"))
    assert found.offers[0].rates_hz == (0.5, 60.0)
    assert found.run.endswith("--source genicam_foveated --set capture.camera=Fovea-Small-1")
    assert (plain.foveates, plain.modes) == (False, ("plain",))
    assert plain.foveation.startswith("offset cannot move while it streams (OffsetX is locked)")
    assert "--source genicam --set capture.camera_options.camera=Fovea-Small-1" in plain.run


def test_a_webcam_tells_formats_sizes_and_rates(device: dict[str, str], tmp_path: Path) -> None:
    names = tmp_path / "names"
    (names / "video250").mkdir(parents=True)
    (names / "video251").mkdir()

    done = run(device, "-c", LISTED, str(names))

    assert done.returncode == 0, done.stderr
    found, gone = json.loads(done.stdout)
    assert (found["name"], found["title"], found["problem"]) == (DEVICE, "Fake Camera", "")
    offers = {(o["pixel_format"], *o["size_px"]): o["rates_hz"] for o in found["offers"]}
    assert offers[("MJPG", 1280, 720)] == [30.0, 15.0]
    assert ("RGGB", 640, 480) in offers
    assert len(offers) == 10
    assert found["foveates"] is False
    assert "cut from them in software" in found["foveation"]
    assert gone["problem"].startswith("/dev/video251: no such device")


def test_a_link_that_survives_replugging_is_shown(tmp_path: Path) -> None:
    (tmp_path / "video3").touch()
    (tmp_path / "usb-cam").symlink_to(tmp_path / "video3")

    assert webcams.by_id(str(tmp_path / "video3"), tmp_path) == str(tmp_path / "usb-cam")
    assert webcams.by_id("/dev/video4", tmp_path / "none") == ""


def usb_device(system: Path, name: str, **texts: str) -> None:
    """Write what the kernel tells of a device; `interface` is class and subclass."""
    (system / name).mkdir(parents=True)
    interface = texts.pop("interface", "ff 00").split()
    for key, text in texts.items():
        (system / name / key).write_text(text + "\n")
    part = system / name / f"{name}:1.0"
    part.mkdir()
    (part / "bInterfaceClass").write_text(interface[0] + "\n")
    (part / "bInterfaceSubClass").write_text(interface[1] + "\n")


def test_devices_that_may_not_be_opened_are_named_with_the_remedy(tmp_path: Path) -> None:
    system, nodes = tmp_path / "sys", tmp_path / "dev"
    usb_device(system, "1-1", busnum="1", devnum="5", idVendor="1209", idProduct="0001")
    usb_device(system, "2-1.4", busnum="2", devnum="7", idVendor="1e10", idProduct="4000",
               product="Blackfly S\x1b[2J", interface="ef 05")  # fmt: skip
    usb_device(system, "2-2", busnum="2", devnum="8", idVendor="046d", idProduct="c52b")
    usb_device(system, "3-1", busnum="x", devnum="", idVendor="1209", idProduct="0001")
    (nodes / "001").mkdir(parents=True)
    (nodes / "001" / "005").touch()

    board, camera = usb_devices(system, nodes)
    (hidden,) = hidden_cameras(system, nodes)

    assert (board.where, board.board, board.vision, board.problem) == ("1.5", True, False, "")
    assert (camera.board, camera.vision) == (False, True)
    assert camera.problem == (
        f"usb 2.7: {nodes / '002' / '007'} is not there (a container without it?)"
    )
    assert (hidden.name, hidden.title) == ("genicam:usb-2.7", r"Blackfly S\x1b[2J")


@pytest.mark.parametrize("ids", [[(0x1209, 1)], [(0x1209, 1), (0xABCD, 0x12)], []])
def test_the_rule_names_every_board_and_the_class_of_cameras(ids: list[tuple[int, int]]) -> None:
    lines = rules(ids).splitlines()
    given = [line for line in lines if not line.startswith("#")]

    assert given == [
        *(
            f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor:04x}", ATTR{{idProduct}}=='
            f'"{product:04x}", MODE="0660", TAG+="uaccess"'
            for vendor, product in ids
        ),
        'SUBSYSTEM=="usb", ENV{ID_USB_INTERFACES}=="*:ef05*:*", MODE="0660", TAG+="uaccess"',
    ]
    assert any(PLACE in line for line in lines if line.startswith("#"))
    assert Path(PLACE).name < "73-seat-late.rules"
