"""Foxglove's schemas, which several viewers open, and pictures in one: Frame -> protobuf bytes.

The schema travels in the file, so that a reader needs no code of ours.
"""

from functools import cache
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from pipeline.messages import Frame
from pipeline.pixel_formats import FORMATS
from pipeline.recording.mcap_file import Topic

IMAGE, ANNOTATIONS = "RawImage", "ImageAnnotations"
LINE_LOOP = 2  # a value of PointsAnnotation.type
STAMP = ("timestamp", 1, "Timestamp")
# message -> name, number and type of its fields, as Foxglove defines them; `*`: repeated
_MESSAGES: dict[str, tuple[tuple[str, int, str], ...]] = {
    "RawImage": (
        STAMP, ("width", 2, "fixed32"), ("height", 3, "fixed32"), ("encoding", 4, "string"),
        ("step", 5, "fixed32"), ("data", 6, "bytes"), ("frame_id", 7, "string"),
    ),
    "Point2": (("x", 1, "double"), ("y", 2, "double")),
    "Color": (("r", 1, "double"), ("g", 2, "double"), ("b", 3, "double"), ("a", 4, "double")),
    "CircleAnnotation": (
        STAMP, ("position", 2, "Point2"), ("diameter", 3, "double"), ("thickness", 4, "double"),
        ("fill_color", 5, "Color"), ("outline_color", 6, "Color"),
    ),
    "PointsAnnotation": (
        STAMP, ("type", 2, "Type"), ("points", 3, "*Point2"), ("outline_color", 4, "Color"),
        ("outline_colors", 5, "*Color"), ("fill_color", 6, "Color"), ("thickness", 7, "double"),
    ),
    "TextAnnotation": (
        STAMP, ("position", 2, "Point2"), ("text", 3, "string"), ("font_size", 4, "double"),
        ("text_color", 5, "Color"), ("background_color", 6, "Color"),
    ),
    "ImageAnnotations": (
        ("circles", 1, "*CircleAnnotation"), ("points", 2, "*PointsAnnotation"),
        ("texts", 3, "*TextAnnotation"), ("timestamp", 5, "Timestamp"),
    ),
}  # fmt: skip
_TYPES = ("UNKNOWN", "POINTS", "LINE_LOOP", "LINE_STRIP", "LINE_LIST")  # of PointsAnnotation
_IN = {  # schema -> the messages that it consists of
    IMAGE: (IMAGE,),
    ANNOTATIONS: (
        "Point2", "Color", "CircleAnnotation", "PointsAnnotation", "TextAnnotation", ANNOTATIONS,
    ),
}  # fmt: skip


def raw_image(frame: Frame, frame_id: str) -> bytes | None:
    """Return a frame as a `RawImage`; None for a format that Foxglove does not know.

    Samples of more than 8 bits are shown in the low bits of 16.
    """
    encoding = _encoding(frame)
    if not encoding or not frame.pixels.size:
        return None
    image = message(IMAGE)()
    image.timestamp.FromNanoseconds(frame.header.stamp_ns)
    image.frame_id = frame_id
    image.height, image.width = frame.pixels.shape[:2]
    image.encoding = encoding
    image.step = frame.pixels.nbytes // frame.pixels.shape[0]
    image.data = np.ascontiguousarray(frame.pixels).tobytes()
    return bytes(image.SerializeToString())


def pixels_of(data: bytes) -> bytes:
    """Return the pixels of a `RawImage`; raises `ValueError` for other bytes."""
    image = message(IMAGE)()
    image.ParseFromString(data)  # its DecodeError is a ValueError
    return bytes(image.data)


def topic(name: str, schema: str = IMAGE) -> Topic:
    """Return the channel of that name, of pictures or of another schema."""
    return Topic(
        name=name, encoding="protobuf", schema_name=f"foxglove.{schema}",
        schema_encoding="protobuf", schema=_files(schema).SerializeToString(),
    )  # fmt: skip


@cache
def message(schema: str) -> Any:
    """Return the protobuf class of a schema."""
    pool = descriptor_pool.DescriptorPool()
    for file in _files(schema).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{schema}"))


def _encoding(frame: Frame) -> str:
    """Return Foxglove's name of a pixel format; empty for none."""
    form = FORMATS.get(frame.pixel_format)
    if form is None or form.packed:
        return ""
    if form.channels == 3:
        return form.name  # rgb8 and bgr8 are named alike
    if form.bits > 8:
        return "16UC1"
    return f"bayer_{form.order}8" if form.order else "mono8"


@cache
def _files(schema: str) -> descriptor_pb2.FileDescriptorSet:
    """Return the schema with what it imports, as MCAP wants it."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"foxglove/{schema}.proto", package="foxglove", syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )  # fmt: skip
    for name in _IN[schema]:
        made = file.message_type.add(name=name)
        for field in _MESSAGES[name]:
            _add_field(made, *field)
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return descriptor_pb2.FileDescriptorSet(file=[stamp, file])


def _add_field(made: Any, name: str, number: int, kind: str) -> None:
    several, kind = kind.startswith("*"), kind.lstrip("*")
    field = made.field.add(name=name, number=number, label=3 if several else 1)
    if kind == "Type":
        kinds = made.enum_type.add(name=kind)
        for value, meaning in enumerate(_TYPES):
            kinds.value.add(name=meaning, number=value)
        field.type, field.type_name = field.TYPE_ENUM, f".foxglove.{made.name}.{kind}"
    elif kind[0].isupper():
        package = "google.protobuf" if kind == "Timestamp" else "foxglove"
        field.type, field.type_name = field.TYPE_MESSAGE, f".{package}.{kind}"
    else:
        field.type = getattr(descriptor_pb2.FieldDescriptorProto, f"TYPE_{kind.upper()}")
