"""The procedural match from a mast: a still camera that shows all of the pitch, read by windows."""

from drivers.scenes.whole_pitch.scene import WholePitchScene

__all__ = ["WholePitchScene"]
