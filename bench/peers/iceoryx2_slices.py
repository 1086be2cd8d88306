"""iceoryx2: loaned slices in shared memory, an event to wake the receiver."""

import ctypes
from typing import Any

import iceoryx2 as iox  # type: ignore[import-not-found, unused-ignore]
import numpy as np

from bench.peers.ruler import Bytes, Meter, Task, Writer, contestant, two_processes

WAIT_MS = 100


def services(task: Task) -> tuple[Any, Any]:
    """Return the publish-subscribe and the event service of this run."""
    iox.set_log_level(iox.LogLevel.Error)
    node = iox.NodeBuilder.new().create(iox.ServiceType.Ipc)
    name = iox.ServiceName.new(task.folder.name)
    pictures = node.service_builder(name).publish_subscribe(iox.Slice[ctypes.c_uint8])
    return (
        pictures.subscriber_max_buffer_size(8).open_or_create(),
        node.service_builder(name).event().open_or_create(),
    )


def as_array(payload: Any, nbytes: int) -> Bytes:
    """Return the payload's memory as an array (nbytes,)."""
    pointer = ctypes.cast(payload.as_ptr(), ctypes.POINTER(ctypes.c_uint8))
    return np.ctypeslib.as_array(pointer, (nbytes,))


def receive(task: Task) -> None:
    """Run the receiving side."""
    meter = Meter(task)
    pictures, events = services(task)
    subscriber = pictures.subscriber_builder().create()
    listener = events.listener_builder().create()
    meter.ready()
    while not meter.finished:
        listener.timed_wait(iox.Duration.from_millis(WAIT_MS))
        while (sample := subscriber.receive()) is not None:
            meter.take(as_array(sample.payload(), task.nbytes))
            sample.delete()
    meter.save()


def send(task: Task) -> None:
    """Run the sending side."""
    writer = Writer(task)
    pictures, events = services(task)
    publisher = pictures.publisher_builder().initial_max_slice_len(task.nbytes).create()
    notifier = events.notifier_builder().create()
    for number in writer.paced():
        sample = publisher.loan_slice_uninit(task.nbytes)
        writer.write(as_array(sample.payload(), task.nbytes), number)
        sample.assume_init().send()
        notifier.notify()
    writer.save()
    writer.wait_read()


if __name__ == "__main__":
    contestant(
        "iceoryx2_slices", "iceoryx2", two_processes("iceoryx2_slices"),
        {"receive": receive, "send": send},
    )  # fmt: skip
