"""iceoryx2: a loaned slice filled in place, an event to wake the reader."""

import ctypes
import hashlib
from typing import Any

import iceoryx2 as iox2
import numpy as np

from bench.peers.ruler import RING, Bytes, Job, Reader, Writer, contest, duet


class Number(ctypes.Structure):
    """What travels beside the payload."""

    _fields_ = [("seq", ctypes.c_uint64)]


def produce(job: Job) -> None:
    """Loan, fill, send, notify."""
    writer = Writer(job)
    topic, event = _services(job)
    publisher = topic.publisher_builder().initial_max_slice_len(job.size_bytes).create()
    notifier = event.notifier_builder().create()
    for seq in writer.turns():
        sample = publisher.loan_slice_uninit(job.size_bytes)
        writer.write(_array(sample.payload(), job.size_bytes), seq)
        sample.user_header().contents.seq = seq
        sample.assume_init().send()
        notifier.notify()
    writer.save()


def consume(job: Job) -> None:
    """Take all there is whenever woken."""
    reader = Reader(job)
    topic, event = _services(job)
    subscriber = topic.subscriber_builder().create()
    listener = event.listener_builder().create()
    reader.ready()
    while not reader.over():
        listener.timed_wait(iox2.Duration.from_millis(100))
        while (sample := subscriber.receive()) is not None:
            payload = _array(sample.payload(), job.size_bytes)
            reader.read(payload, sample.user_header().contents.seq)
            sample.delete()
    reader.save()


def _services(job: Job) -> tuple[Any, Any]:
    iox2.set_log_level(iox2.LogLevel.Error)
    node = iox2.NodeBuilder.new().create(iox2.ServiceType.Ipc)
    name = "fovea-bench-" + hashlib.sha256(job.folder.encode()).hexdigest()[:12]
    topic = (
        node.service_builder(iox2.ServiceName.new(name))
        .publish_subscribe(iox2.Slice[ctypes.c_uint8])
        .user_header(Number)
        .subscriber_max_buffer_size(RING)
        .open_or_create()
    )
    event = node.service_builder(iox2.ServiceName.new(f"{name}-event")).event().open_or_create()
    return topic, event


def _array(payload: Any, size_bytes: int) -> Bytes:
    pointer = ctypes.cast(payload.as_ptr(), ctypes.POINTER(ctypes.c_uint8))
    return np.ctypeslib.as_array(pointer, (size_bytes,))


if __name__ == "__main__":
    contest(
        "iceoryx2", ("iceoryx2", "numpy"), duet(__spec__.name), produce=produce, consume=consume
    )
