"""`python -m bench.usb --seconds 60`."""

from bench.usb.stream import main

if __name__ == "__main__":
    main()
