"""What runs any graph: messages, the operator contract, bus, frame pool, runners, supervisor."""

from pipeline.contract import Input, Operator, Output, Source
from pipeline.errors import (
    DriverError,
    FoveaError,
    GraphError,
    MessageError,
    PoolExhausted,
    RunError,
    SettingsError,
    WeightsError,
)
from pipeline.messages import (
    Detections,
    Frame,
    Geometry,
    Header,
    Message,
    Percept,
    RoiFeatures,
    RoiSchedule,
    Scanpath,
    Span,
    Tracks,
)

__all__ = [
    "Detections",
    "DriverError",
    "FoveaError",
    "Frame",
    "Geometry",
    "GraphError",
    "Header",
    "Input",
    "Message",
    "MessageError",
    "Operator",
    "Output",
    "Percept",
    "PoolExhausted",
    "RoiFeatures",
    "RoiSchedule",
    "RunError",
    "Scanpath",
    "SettingsError",
    "Source",
    "Span",
    "Tracks",
    "WeightsError",
]
