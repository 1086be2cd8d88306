"""`python -m bench.results`."""

from bench.results.page import main

if __name__ == "__main__":
    main()
