"""Kinds of sensors for tests: found, missing, broken, silent, and one that ends its process."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from drivers.attached.listing import AttachedSensor
from pipeline.errors import DriverError, InstallError


def found() -> Iterator[dict[str, Any]]:
    print("what a library prints")
    yield asdict(AttachedSensor(name="test:1", title="a sensor", foveation="it does not"))
    yield asdict(AttachedSensor(name="test:2", title="another", problem="it is in use"))


def missing() -> Iterator[dict[str, Any]]:
    raise InstallError("test: expected the package nowhere, got none: pip install nowhere")
    yield {}


def broken() -> Iterator[dict[str, Any]]:
    yield asdict(AttachedSensor(name="test:1", title="a sensor"))
    raise DriverError("test: the bus \x1b[31m is broken")


def silent() -> Iterator[dict[str, Any]]:
    yield asdict(AttachedSensor(name="test:1", title="a sensor"))
    time.sleep(3600)


def dripping() -> Iterator[dict[str, Any]]:
    for number in range(1000):
        yield asdict(AttachedSensor(name=f"test:{number}", title="one of many"))
        time.sleep(0.5)


def crashing() -> Iterator[dict[str, Any]]:
    os.kill(os.getpid(), signal.SIGSEGV)
    yield {}


def leaving() -> Iterator[dict[str, Any]]:
    os._exit(7)
    yield {}


def endless() -> Iterator[dict[str, Any]]:
    yield {"name": "x" * (2 << 20)}


def unfit() -> Iterator[dict[str, Any]]:
    yield {"nme": "test:1"}
