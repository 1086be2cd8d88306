"""What can go wrong on the link; each is a `DriverError`.

DriverError
 └ LinkError
    ├ Unplugged     the board is gone
    ├ Stalled       an end point is halted, or the board refused a request
    ├ Overflow      the board sent more than was asked for
    ├ NoAnswer      a request was not answered in time
    ├ NoUsbMemory   the kernel grants no memory for a read
    └ BadBlock      bytes that the protocol does not allow
"""

from pipeline.errors import DriverError


class LinkError(DriverError):
    """Base of the family."""


class Unplugged(LinkError):
    """The board is gone."""


class Stalled(LinkError):
    """An end point is halted until `clear_halt`, or the board refused a request."""


class Overflow(LinkError):
    """The board sent more than was asked for; that data is lost."""


class NoAnswer(LinkError):
    """A request was not answered in time."""


class NoUsbMemory(LinkError):
    """The kernel grants no more memory for reads in flight."""


class BadBlock(LinkError):
    """Bytes from the board that the protocol does not allow."""
