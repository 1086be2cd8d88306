"""Plain cameras as sensors: webcams, network streams, and whatever keeps `drivers.camera`."""

from drivers.cameras.camera_sensor import CameraSensor, CameraSensorSettings
from drivers.cameras.network_stream import NetworkStream, NetworkStreamSettings
from drivers.cameras.webcam import Webcam, WebcamSettings

__all__ = [
    "CameraSensor",
    "CameraSensorSettings",
    "NetworkStream",
    "NetworkStreamSettings",
    "Webcam",
    "WebcamSettings",
]
