"""Program: has the library evaluate damaged descriptions that the driver lets through.

Arguments: description, first seed, number. Prints how many were let through; a crash of the library
ends it, after the seed in progress was printed.
"""

import ctypes
import sys
from pathlib import Path
from typing import Any

from drivers.genicam.aravis import library
from drivers.genicam.foveation import foveation
from drivers.genicam.vetting import vetted_nodes
from pipeline.errors import DriverError
from tests.drivers.genicam.mutations import mutated

ASKED = (
    "Width", "Height", "OffsetX", "OffsetY", "BinningHorizontal", "PixelFormat", "SensorWidth",
    "TriggerMode", "TriggerSource", "TriggerSoftware", "AcquisitionFrameRate", "ExposureTimeAbs",
    "TLParamsLocked", "PayloadSize", "DeviceVendorName",
)  # fmt: skip


def main(path: str, first: str, number: str) -> None:
    """Evaluate and print."""
    aravis = library().aravis
    aravis.enable_interface("Fake")
    aravis.update_device_list()
    device = aravis.open_device("Fake_1")
    text = Path(path).read_bytes()
    accepted = 0
    for seed in range(int(first), int(first) + int(number)):
        damaged = mutated(text, seed)
        try:
            foveation(vetted_nodes(damaged))
        except DriverError:
            continue
        print(seed, flush=True)
        accepted += 1
        memory = ctypes.create_string_buffer(damaged, len(damaged))
        described = aravis.Gc.new(device, ctypes.addressof(memory), len(damaged))
        if described is not None:
            evaluate(described)
    print(f"let through: {accepted}")


def evaluate(described: Any) -> None:
    """Ask what the driver asks of an open camera."""
    for name in ASKED:
        node = described.get_node(name)
        for question in ("is_locked", "is_available", "get_value_as_string", "get_value", "get_max",
                         "get_min", "get_inc"):  # fmt: skip
            asked = getattr(node, question, None)
            try:
                if asked is not None:
                    asked()
            except library().error:
                continue
            except TypeError:  # a question with an argument
                continue


if __name__ == "__main__":
    main(*sys.argv[1:])
