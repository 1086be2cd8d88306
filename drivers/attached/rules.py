"""The udev rule that lets the user at the screen open boards and USB3 Vision cameras: text out."""

from collections.abc import Iterable

from drivers.board_ids import PRODUCT_ID, VENDOR_ID

# before 73-seat-late.rules, which grants access to what has the tag `uaccess`, and after
# 50-udev-default.rules, which reads the interfaces of a device
PLACE = "/etc/udev/rules.d/70-fovea.rules"
REMEDY = f"fovea sensors rules | sudo tee {PLACE}, then plug it in again"
GRANT = 'MODE="0660", TAG+="uaccess"'
# interface class EF, subclass 05 (USB3 Vision 1.0, table 3-1), in whatever device it is
VISION = f'SUBSYSTEM=="usb", ENV{{ID_USB_INTERFACES}}=="*:ef05*:*", {GRANT}'


def rules(ids: Iterable[tuple[int, int]] = ((VENDOR_ID, PRODUCT_ID),)) -> str:
    """Return the file: comments that say where it belongs, a line for each board, one for cameras.

    >>> print(rules([(0x1209, 0x0001)]).splitlines()[4])
    SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="0001", MODE="0660", TAG+="uaccess"
    """
    boards = "".join(
        f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor:04x}", ATTR{{idProduct}}=="{product:04x}", '
        f"{GRANT}\n"
        for vendor, product in ids
    )
    return f"""\
# lets the user at the screen open these devices; put it where udev looks, and load it:
#   fovea sensors rules | sudo tee {PLACE}
#   sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb
# dual-stream boards
{boards}\
# USB3 Vision cameras of any maker
{VISION}
"""
