"""The robot's consumer: pictures and joints in, targets of the arms out."""

from operators.manipulation.manipulation import ActionChunking, ActionChunkingSettings

__all__ = ["ActionChunking", "ActionChunkingSettings"]
