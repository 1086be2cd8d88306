"""How a virtual board fails towards its transport."""


class Refused(Exception):
    """A request that the board answers with a stall."""


class Halted(Exception):
    """The end point is halted until it is cleared."""


class Gone(Exception):
    """The board is not there (now)."""


class TooMuch(Exception):
    """More came than was asked for."""
