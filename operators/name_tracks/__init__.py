"""Name tracks by what was read on them, and keep the name."""

from operators.name_tracks.name_tracks import NameTracks

__all__ = ["NameTracks"]
