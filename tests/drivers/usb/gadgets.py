"""Program: the gadget's program again and again, without importing it each time.

Reads a list of options from each line (JSON): runs the program with them in a process of its own;
an empty list terminates it, and `ended with STATUS` is printed. Prints `ready` first.
"""

import json
import os
import signal
import sys

from drivers.virtual_board import gadget


def main() -> None:
    """Obey until the input ends."""
    running = 0
    print("ready", flush=True)
    try:
        for line in sys.stdin:
            if options := json.loads(line):
                running = os.fork()
                if not running:
                    gadget.main(options)
            else:
                status, running = _ended(running), 0
                print(f"ended with {status}", flush=True)
    finally:
        if running:
            _ended(running)


def _ended(process: int) -> int:
    os.kill(process, signal.SIGTERM)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


if __name__ == "__main__":
    main()
