"""Pictures as Foxglove's `RawImage`, which Foxglove and Rerun open: Frame -> protobuf bytes.

The schema travels in the file, so that a reader needs no code of ours.
"""

from functools import cache
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from pipeline.messages import Frame
from pipeline.pixel_formats import FORMATS
from pipeline.recording.mcap_file import Topic

NAME = "foxglove.RawImage"
# name, number and protobuf type of its fields, as Foxglove defines them
_FIELDS = (
    ("timestamp", 1, "message"),
    ("width", 2, "fixed32"),
    ("height", 3, "fixed32"),
    ("encoding", 4, "string"),
    ("step", 5, "fixed32"),
    ("data", 6, "bytes"),
    ("frame_id", 7, "string"),
)


def raw_image(frame: Frame, frame_id: str) -> bytes | None:
    """Return a frame as a `RawImage`; None for a format that Foxglove does not know.

    Samples of more than 8 bits are shown in the low bits of 16.
    """
    encoding = _encoding(frame)
    if not encoding or not frame.pixels.size:
        return None
    image = _message()()
    image.timestamp.FromNanoseconds(frame.header.stamp_ns)
    image.frame_id = frame_id
    image.height, image.width = frame.pixels.shape[:2]
    image.encoding = encoding
    image.step = frame.pixels.nbytes // frame.pixels.shape[0]
    image.data = np.ascontiguousarray(frame.pixels).tobytes()
    return bytes(image.SerializeToString())


def pixels_of(data: bytes) -> bytes:
    """Return the pixels of a `RawImage`; raises `ValueError` for other bytes."""
    image = _message()()
    image.ParseFromString(data)  # its DecodeError is a ValueError
    return bytes(image.data)


def topic(name: str) -> Topic:
    """Return the channel of pictures of that name."""
    return Topic(
        name=name, encoding="protobuf", schema_name=NAME, schema_encoding="protobuf",
        schema=_files().SerializeToString(),
    )  # fmt: skip


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
def _files() -> descriptor_pb2.FileDescriptorSet:
    """Return the schema with what it imports, as MCAP wants it."""
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove/RawImage.proto", package="foxglove", syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )  # fmt: skip
    image = file.message_type.add(name="RawImage")
    for name, number, kind in _FIELDS:
        field = image.field.add(name=name, number=number, label=1)
        field.type = getattr(descriptor_pb2.FieldDescriptorProto, f"TYPE_{kind.upper()}")
        if kind == "message":
            field.type_name = ".google.protobuf.Timestamp"
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return descriptor_pb2.FileDescriptorSet(file=[stamp, file])


@cache
def _message() -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in _files().file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(NAME))
