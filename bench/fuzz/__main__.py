"""`python -m bench.fuzz graphs | orders | wire`."""

from bench.fuzz.fuzz import fuzz

if __name__ == "__main__":
    fuzz()
