"""GigE Vision and USB3 Vision cameras through Aravis (extra `genicam`)."""

from drivers.genicam.camera import GenicamCamera, GenicamCameraSettings
from drivers.genicam.discovery import AttachedCamera, discover

__all__ = ["AttachedCamera", "GenicamCamera", "GenicamCameraSettings", "discover"]
