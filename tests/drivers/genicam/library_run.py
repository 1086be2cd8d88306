"""Program: has the library evaluate damaged descriptions that the driver lets through.

Arguments: first seed, number. Registers are those of a virtual camera, which any address suits; the
one who starts the program holds `loopback`. Prints how many were let through; a crash of the
library ends it, after the seed in progress was printed.
"""

import ctypes
import sys
from typing import Any

from bench.fuzz.descriptions import mutated
from drivers.genicam.aravis import library
from drivers.genicam.foveation import foveation
from drivers.genicam.vetting import vetted_nodes
from pipeline.errors import DriverError
from tests.drivers.genicam.virtual_camera import Nature, VirtualCamera, describe

ASKED = ("Width", "OffsetX", "BinningHorizontal", "PixelFormat", "TriggerSoftware", "SensorWidth")
QUESTIONS = ("is_locked", "get_value_as_string", "get_max", "get_inc")


def main(first: str, number: str) -> None:
    """Evaluate and print."""
    text, accepted = describe(Nature(sets=8)), 0
    with VirtualCamera():
        aravis = library().aravis
        aravis.update_device_list()
        device = aravis.open_device("Fovea-Virtual-V1")
        for seed in range(int(first), int(first) + int(number)):
            damaged = mutated(text, seed)
            try:
                foveation(vetted_nodes(damaged))
            except DriverError:
                continue
            print(seed, flush=True)
            accepted += 1
            memory = ctypes.create_string_buffer(damaged, len(damaged))
            try:
                described = aravis.Gc.new(device, ctypes.addressof(memory), len(damaged))
            except TypeError:  # what the binding makes of none: the library refuses it
                continue
            evaluate(described)
    print(f"let through: {accepted}")


def evaluate(described: Any) -> None:
    """Ask what the driver asks of an open camera; an error is an answer."""
    for name in ASKED:
        node = described.get_node(name)
        for question in QUESTIONS:
            asked = getattr(node, question, None)
            try:
                if asked is not None:
                    asked()
            except library().error:
                continue


if __name__ == "__main__":
    main(*sys.argv[1:])
