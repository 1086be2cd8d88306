"""What the doctor says about sensors: each problem has a remedy, and none is needed."""

from pathlib import Path

import pytest

from drivers.attached.diagnosis import found, permissions, usb_memory
from drivers.attached.listing import AttachedSensor, KindFound
from pipeline.doctor.finding import Finding
from tests.drivers.attached.test_kinds import usb_device


def told(findings: list[Finding]) -> list[tuple[str, str]]:
    assert all(finding.todo for finding in findings if finding.verdict != "ok")
    return [(finding.verdict, finding.why) for finding in findings]


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        (KindFound(kind="usb", what="boards"), [("ok", "boards: none")]),
        (
            KindFound(kind="usb", what="boards", missing="expected pyusb, got none: pip install x"),
            [("ok", "boards are not looked for: expected pyusb, got none: pip install x")],
        ),
        (
            KindFound(kind="usb", what="boards", problem="no answer within 10 s"),
            [("warning", "boards: no answer within 10 s"), ("ok", "boards: none")],
        ),
        (
            KindFound(
                kind="usb",
                what="boards",
                sensors=(
                    AttachedSensor(name="usb:1", title="one"),
                    AttachedSensor(name="usb:2", title="two", problem="in use"),
                ),
            ),
            [("ok", "boards: usb:1, usb:2"), ("warning", "usb:2: in use")],
        ),
    ],
)
def test_every_kind_is_told_and_every_problem_is_a_warning(
    kind: KindFound, wanted: list[tuple[str, str]]
) -> None:
    assert told(list(found(kind))) == wanted


def test_a_device_that_may_not_be_opened_is_a_warning_with_the_rule(tmp_path: Path) -> None:
    system = tmp_path / "sys"
    empty = list(permissions(system, tmp_path))
    usb_device(system, "1-1", busnum="1", devnum="5", idVendor="1209", idProduct="0001")

    (closed,) = permissions(system, tmp_path / "dev")

    assert [finding.verdict for finding in empty] == ["ok"]
    assert closed.verdict == "warning"
    assert closed.why.startswith("usb 1.5: ")
    assert closed.todo.startswith("fovea sensors rules | sudo tee /etc/udev/rules.d/70-fovea.rules")


@pytest.mark.parametrize(
    ("text", "verdict", "why"),
    [
        ("8\n", "warning", "8 MB for reads in flight (usbfs_memory_mb), a board reads"),
        ("16\n", "ok", "16 MB for reads in flight (usbfs_memory_mb): enough for"),
        ("1000\n", "ok", "1000 MB for reads in flight (usbfs_memory_mb)"),
        ("0\n", "ok", "no limit for reads in flight (usbfs_memory_mb 0)"),
        ("many\n", "ok", "this kernel has no USB"),
    ],
)  # fmt: skip
def test_memory_of_usb_has_to_hold_the_reads_of_a_board(
    text: str, verdict: str, why: str, tmp_path: Path
) -> None:
    setting = tmp_path / "usbfs_memory_mb"
    setting.write_text(text)

    finding = usb_memory(setting)

    assert finding.verdict == verdict
    assert finding.why.startswith(why)
    assert (finding.todo == f"echo 256 | sudo tee {setting}") == (verdict == "warning")
    assert usb_memory(tmp_path / "none").why == "this kernel has no USB"
