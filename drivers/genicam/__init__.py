"""GigE Vision and USB3 Vision cameras through Aravis (extra `genicam`)."""

from drivers.genicam.camera import GenicamCamera, GenicamCameraSettings
from drivers.genicam.discovery import AttachedCamera, discover
from drivers.genicam.sensor import GenicamSensor
from drivers.genicam.sensor_settings import GenicamSensorSettings

__all__ = [
    "AttachedCamera",
    "GenicamCamera",
    "GenicamCameraSettings",
    "GenicamSensor",
    "GenicamSensorSettings",
    "discover",
]
