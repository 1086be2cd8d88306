"""Descriptors of a board: USB 3 SuperSpeed, one vendor interface, two bulk IN end points."""

from drivers.usb.link import PRODUCT_ID, VENDOR_CLASS, VENDOR_ID

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
