"""What `fovea doctor` says about sensors: libraries, permissions, USB memory, what is attached."""

from collections.abc import Iterator
from pathlib import Path

from drivers.attached.listing import KindFound
from drivers.attached.permissions import NODES, SYSTEM, usb_devices
from drivers.attached.rules import REMEDY
from drivers.attached.search import search
from pipeline.doctor.finding import Finding, ok, warning

USB_MEMORY = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
LEAST_MB = 16  # 12 MiB of reads in flight of one board, and some for other devices
MORE_MB = 256


def examine_sensors() -> Iterator[Finding]:
    """Yield all findings on sensors; none of them is needed, so none is worse than a warning."""
    yield usb_memory()
    yield from permissions()
    for kind in search():
        yield from found(kind)


def found(kind: KindFound) -> Iterator[Finding]:
    """Yield one finding on a kind, and one for each of its sensors that cannot be used."""
    if kind.missing:
        yield ok(kind.kind, f"{kind.what} are not looked for: {kind.missing}")
        return
    if kind.problem:
        todo = "fovea sensors --timeout-s 60, and look at the device's cable and power"
        yield warning(kind.kind, f"{kind.what}: {kind.problem}", todo)
    names = ", ".join(sensor.name for sensor in kind.sensors) or "none"
    yield ok(kind.kind, f"{kind.what}: {names}")
    for sensor in kind.sensors:
        if sensor.problem:
            todo = sensor.remedy or "end the other program, or plug it in again"
            yield warning(kind.kind, f"{sensor.name}: {sensor.problem}", todo)


def permissions(system: Path = SYSTEM, nodes: Path = NODES) -> Iterator[Finding]:
    """Yield a warning for each board or camera on USB that this user may not open."""
    closed = [device for device in usb_devices(system, nodes) if device.problem]
    for device in closed:
        yield warning("usb access", device.problem, REMEDY)
    if not closed:
        count = sum(1 for _ in usb_devices(system, nodes))
        yield ok("usb access", f"{count} boards and USB3 Vision cameras, none that is closed")


def usb_memory(setting: Path = USB_MEMORY) -> Finding:
    """Check the memory that the kernel grants to reads of all USB devices together."""
    what = "usb memory"
    try:
        size_mb = int(setting.read_text())
    except (OSError, ValueError):
        return ok(what, "this kernel has no USB")
    told = f"{size_mb} MB for reads in flight (usbfs_memory_mb)"
    todo = f"echo {MORE_MB} | sudo tee {setting}"
    if 0 < size_mb < LEAST_MB:
        return warning(what, f"{told}, a board reads with up to 12", todo)
    if size_mb == LEAST_MB:
        return ok(what, f"{told}: enough for one board; for more or USB3 Vision: {todo}")
    return ok(what, told if size_mb else "no limit for reads in flight (usbfs_memory_mb 0)")
