"""Prepare frames for networks: any pixel format in, 8-bit RGB out, at most `width_px` wide."""

from operators.downsample.downsample import Downsample, DownsampleSettings, fitted

__all__ = ["Downsample", "DownsampleSettings", "fitted"]
