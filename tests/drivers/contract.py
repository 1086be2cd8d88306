"""The contract of a sensor for tests: `drivers.contract`, and what only tests do with a sensor."""

import threading

from drivers.contract import check_addressable as assert_addressable
from drivers.contract import check_sensor, command, memory, read, refuse
from drivers.sensor import DualStreamSensor, Exposure

__all__ = [
    "answers_to_a_stop",
    "assert_addressable",
    "check_sensor",
    "command",
    "memory",
    "read",
    "refuse",
    "started",
]


def started(sensor: DualStreamSensor, *, realtime: bool = False) -> DualStreamSensor:
    sensor.open(realtime=realtime)
    sensor.start()
    return sensor


def answers_to_a_stop(sensor: DualStreamSensor) -> list[Exposure | None]:
    """Stop a sensor while another thread waits in `read`; return what that read returned."""
    answers: list[Exposure | None] = []
    reader = threading.Thread(target=lambda: answers.append(sensor.read(memory)))
    reader.start()
    sensor.stop()
    reader.join(30)
    sensor.close()
    return answers
