"""`python -m bench.fuzz graphs | orders | wire | usb`."""

from bench.fuzz.fuzz import fuzz

if __name__ == "__main__":
    fuzz()
