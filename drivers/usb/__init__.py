"""Dual-stream boards on USB."""

from drivers.usb.board import DualStreamBoard as DualStreamBoard
from drivers.usb.board_settings import DualStreamBoardSettings as DualStreamBoardSettings
