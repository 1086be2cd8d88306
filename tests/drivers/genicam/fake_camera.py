"""Program: Aravis' fake GigE camera F1 on the loopback, until it is killed."""

import threading

from drivers.genicam.aravis import library

TRIGGERS_HZ = 500.0  # it looks for software triggers this often


def main() -> None:
    """Run, and say `ready` once it answers."""
    camera = library().aravis.GvFakeCamera.new("127.0.0.1", "F1")
    camera.get_fake_camera().set_trigger_frequency(TRIGGERS_HZ)
    print("ready" if camera.is_running() else "no port", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
