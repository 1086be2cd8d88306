"""Vendor and product id of dual-stream boards, known without pyusb."""

VENDOR_ID, PRODUCT_ID = 0x1209, 0x0001  # for tests only; a maker has its own
