"""Program: Aravis' own fake GigE camera on the loopback, to try graphs without a device.

`python -m drivers.genicam.fake_camera [SERIAL]` prints `ready` and runs until it is ended. It is
called Aravis-Fake-SERIAL, has 2048x2048 pixels and shows a moving ramp, wherever it looks.
"""

import sys
import threading

from drivers.genicam.aravis import library
from pipeline.errors import FoveaError

TRIGGERS_HZ = 500.0  # it looks for software triggers this often; the packaged program 25 times
LONGEST = 15  # characters of a serial number


def main(serial: str = "F1") -> None:
    """Run; ends with a sentence where the port of GigE cameras is taken."""
    if not 1 <= len(serial) <= LONGEST:
        sys.exit(f"serial: expected 1 to {LONGEST} characters, got {len(serial)}")
    try:
        camera = library().aravis.GvFakeCamera.new("127.0.0.1", serial)
    except FoveaError as error:
        sys.exit(str(error))
    if not camera.is_running():
        sys.exit("fake camera: expected UDP port 3956 on 127.0.0.1 to be free, got one in use")
    camera.get_fake_camera().set_trigger_frequency(TRIGGERS_HZ)
    print("ready", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except KeyboardInterrupt:
        sys.exit(130)
