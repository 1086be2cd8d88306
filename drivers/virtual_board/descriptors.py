"""Descriptors of a board: USB 3 SuperSpeed, one vendor interface, two bulk IN end points."""

import struct
from collections.abc import Mapping

from drivers.board_ids import PRODUCT_ID, VENDOR_ID
from drivers.usb.link import VENDOR_CLASS
from drivers.virtual_board.errors import Refused

MAX_PACKET_BYTES = 1024
STRINGS = ("fovea", "virtual dual-stream board", "V0001")

DEVICE = {
    "bLength": 18, "bDescriptorType": 1, "bcdUSB": 0x0300, "bDeviceClass": 0,
    "bDeviceSubClass": 0, "bDeviceProtocol": 0, "bMaxPacketSize0": 9, "idVendor": VENDOR_ID,
    "idProduct": PRODUCT_ID, "bcdDevice": 0x0100, "iManufacturer": 1, "iProduct": 2,
    "iSerialNumber": 3, "bNumConfigurations": 1,
}  # fmt: skip
CONFIGURATION = {
    "bLength": 9, "bDescriptorType": 2, "wTotalLength": 9 + 9 + 2 * (7 + 6), "bNumInterfaces": 1,
    "bConfigurationValue": 1, "iConfiguration": 0, "bmAttributes": 0x80, "bMaxPower": 112,
}  # fmt: skip
INTERFACE = {
    "bLength": 9, "bDescriptorType": 4, "bInterfaceNumber": 0, "bAlternateSetting": 0,
    "bNumEndpoints": 2, "bInterfaceClass": VENDOR_CLASS, "bInterfaceSubClass": 0xFE,
    "bInterfaceProtocol": 1, "iInterface": 0,
}  # fmt: skip
ENDPOINTS = tuple(
    {
        "bLength": 7, "bDescriptorType": 5, "bEndpointAddress": 0x81 + k, "bmAttributes": 2,
        "wMaxPacketSize": MAX_PACKET_BYTES, "bInterval": 0,
    }
    for k in range(2)
)  # fmt: skip
COMPANION = struct.pack("<BBBBH", 6, 0x30, 15, 0, 0)  # bursts of 16 packets
CAPABILITY = struct.pack("<BBBBHBBH", 10, 0x10, 3, 0, 0x000E, 1, 10, 0x07FF)  # SuperSpeed
BOS = struct.pack("<BBHB", 5, 0x0F, 5 + len(CAPABILITY), 1) + CAPABILITY
LANGUAGE = b"\x04\x03\x09\x04"  # one: English (United States)
GET_STATUS, GET_DESCRIPTOR, GET_CONFIGURATION = 0, 6, 8
ACCEPTED = (3, 5, 9, 11, 48, 49)  # SET_FEATURE, _ADDRESS, _CONFIGURATION, _INTERFACE, _SEL, delay


def string_descriptor(index: int) -> bytes:
    """Return a string descriptor; 0 is the list of languages. Raises `Refused`."""
    if not index:
        return LANGUAGE
    if index > len(STRINGS):
        raise Refused(f"no string {index}")
    text = STRINGS[index - 1].encode("utf-16-le")
    return bytes([len(text) + 2, 3]) + text


def configuration_descriptor() -> bytes:
    """Return the configuration with all that belongs to it."""
    return _packed(CONFIGURATION) + b"".join(interface_descriptors())


def interface_descriptors(packet_bytes: int = MAX_PACKET_BYTES) -> list[bytes]:
    """Return the interface and its end points; only SuperSpeed's packets have companions."""
    companion = [COMPANION] if packet_bytes == MAX_PACKET_BYTES else []
    found = [_packed(INTERFACE)]
    for end_point in ENDPOINTS:
        found += [_packed({**end_point, "wMaxPacketSize": packet_bytes}), *companion]
    return found


def standard_answer(kind: int, request: int, value: int, length: int) -> bytes:
    """Answer a standard request as a board does; raises `Refused`."""
    if request == GET_DESCRIPTOR:
        which = value >> 8
        if which == 3:
            return string_descriptor(value & 0xFF)[:length]
        known = {1: _packed(DEVICE), 2: configuration_descriptor(), 15: BOS}
        if which in known:
            return known[which][:length]
    if request == GET_STATUS:
        return bytes(2)[:length]
    if request == GET_CONFIGURATION:
        return bytes([1])
    if request in ACCEPTED or (request == 1 and not kind & 0x80):
        return b""
    raise Refused(f"no standard request {request}")


def _packed(fields: Mapping[str, int]) -> bytes:
    """Pack a descriptor: the first letters of a field's name tell its width."""
    form = "<" + "".join("H" if name.startswith(("bcd", "w", "id")) else "B" for name in fields)
    return struct.pack(form, *fields.values())
