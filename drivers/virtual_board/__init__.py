"""A board that is not there: the device's side of the wire protocol, for tests and for trying."""

from drivers.virtual_board.backend import VirtualBackend as VirtualBackend
from drivers.virtual_board.backend import VirtualBoardSettings as VirtualBoardSettings
