"""A USB gadget in ConfigFS: what it is called, which function it has, on which port it is.

The files are those of the kernel's Documentation/usb/gadget_configfs.rst. Whatever is made is
removed again in the reverse order, also when only a part of it could be made.
"""

import errno
import re
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from drivers.virtual_board.descriptors import CONFIGURATION, DEVICE, STRINGS
from drivers.virtual_board.function_fs import MOUNTS, unmount_leftovers
from pipeline.errors import DriverError, SettingsError

CONFIG_FS = Path("/sys/kernel/config")
CONTROLLERS = Path("/sys/class/udc")
USB_2 = 0x0200  # the kernel says 3.x itself where the port is one
SUPER_SPEED_MA = 8  # one unit of the configuration's power
LANGUAGE = "0x409"
NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")


class GadgetConfiguration:
    """A gadget with one FunctionFS function of the same name; `close` is safe after any outcome."""

    def __init__(self, name: str, *, config_fs: Path = CONFIG_FS, mounts: Path = MOUNTS) -> None:
        if not NAME.fullmatch(name):
            raise SettingsError(f"--name: expected 1 to 32 letters, digits, - or _, got {name!r}")
        self.folder = config_fs / "usb_gadget" / name
        self._name, self._mounts = name, mounts
        self._function = self.folder / "functions" / f"ffs.{name}"
        self._made = ExitStack()

    def make(self, serial: str) -> None:
        """Describe the gadget to the kernel; no host sees it yet. Raises `DriverError`."""
        if not self.folder.parent.is_dir():
            raise DriverError(
                f"gadget: {self.folder.parent}: not there; `modprobe libcomposite` and "
                f"`mount -t configfs none {self.folder.parent.parent}` make it"
            )
        self._check_unused()
        unmount_leftovers(self._name, self._mounts)  # of a killed program, not of one that runs
        self._remove_leftovers()
        try:
            self._describe(serial)
        except OSError as error:
            self.close()
            raise self._refused(error) from None

    def bind(self, controller: str) -> None:
        """Plug the gadget in; its function must be described. Raises `DriverError`."""
        try:
            (self.folder / "UDC").write_text(controller)
        except OSError as error:
            raise self._refused(error, controller) from None

    def unbind(self) -> None:
        """Pull the cable; does nothing where there is none."""
        with suppress(OSError):  # ENODEV: it is not bound
            (self.folder / "UDC").write_text("\n")

    def close(self) -> None:
        """Remove all that was made."""
        self._made.close()

    def _describe(self, serial: str) -> None:
        manufacturer, product, _ = STRINGS
        self._folder(self.folder)
        for field in ("idVendor", "idProduct", "bcdDevice"):
            (self.folder / field).write_text(f"{DEVICE[field]:#06x}")
        (self.folder / "bcdUSB").write_text(f"{USB_2:#06x}")
        strings = self.folder / "strings" / LANGUAGE
        self._folder(strings)
        (strings / "manufacturer").write_text(manufacturer)
        (strings / "product").write_text(product)
        (strings / "serialnumber").write_text(serial)
        self._folder(self._function)
        configuration = self.folder / "configs" / "c.1"
        self._folder(configuration)
        (configuration / "bmAttributes").write_text(f"{CONFIGURATION['bmAttributes']:#04x}")
        power_ma = CONFIGURATION["bMaxPower"] * SUPER_SPEED_MA
        (configuration / "MaxPower").write_text(str(power_ma))
        link = configuration / self._function.name
        self._made.callback(_quietly, link.unlink)
        link.symlink_to(self._function)

    def _folder(self, path: Path) -> None:
        """Make a folder whose removal is planned first: a signal may come in between."""
        self._made.callback(_quietly, path.rmdir)
        path.mkdir()

    def _check_unused(self) -> None:
        """Raise `DriverError` where a gadget of this name is plugged in."""
        try:
            controller = (self.folder / "UDC").read_text().strip()
        except OSError:
            return  # there is none; what cannot be removed is refused later
        if controller:
            raise DriverError(
                f"--name: expected a name that no gadget has, got that of one at {controller}"
            )

    def _remove_leftovers(self) -> None:
        """Remove what a killed program left."""
        if not self.folder.is_dir():
            return
        configuration = self.folder / "configs" / "c.1"
        strings = self.folder / "strings" / LANGUAGE
        try:
            _quietly((configuration / self._function.name).unlink)
            for path in (configuration, self._function, strings, self.folder):
                _quietly(path.rmdir)
        except OSError as error:
            raise DriverError(
                f"--name: expected a name that no gadget has, got that of {self.folder}, which "
                f"cannot be removed: {error.strerror}"
            ) from None

    def _refused(self, error: OSError, controller: str = "") -> DriverError:
        root, taken = "no permission; it takes root", f"{controller} is in use by another gadget"
        why = {
            errno.EACCES: root, errno.EPERM: root, errno.EBUSY: taken, errno.ENODEV: taken,
            errno.ENOENT: "the kernel has no FunctionFS; `modprobe usb_f_fs` loads it",
        }.get(error.errno or 0, str(error.strerror))  # fmt: skip
        return DriverError(f"gadget: {self.folder}: {why}")


def controller_of(wanted: str = "", *, controllers: Path = CONTROLLERS) -> str:
    """Return the USB device controller of that name, or the only one; raises `DriverError`."""
    found = sorted(p.name for p in controllers.iterdir()) if controllers.is_dir() else []
    if not found:
        raise DriverError(
            f"gadget: {controllers}: no USB device controller; this machine has no USB port that "
            "can be a device, or the driver of the port is not loaded or set to be a host"
        )
    if wanted and wanted not in found:
        raise DriverError(f"--udc: expected one of {', '.join(found)}, got {wanted}")
    if not wanted and len(found) > 1:
        raise DriverError(f"--udc: expected one of {', '.join(found)}, got none")
    return wanted or found[0]


def _quietly(act: Callable[[], None]) -> None:
    """Remove something that may never have been made."""
    with suppress(FileNotFoundError):
        act()
