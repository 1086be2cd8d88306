"""Which labelled stills are for training, for choosing and for testing, written down beforehand.

Broadcast stills are split by match, the first part of a file's name. The matches are put in order
by the SHA-256 of that part, which knows nothing of pictures or results: the first two are the test,
the next one with at least 30 stills is for development (thresholds, choices), all others are for
training. The stills of the whole pitch are of one match: its first half is for training, of the
second half clip 1 is for development and clips 2 to 6, 39 of the 75 stills, are the test.
"""

from collections.abc import Mapping
from hashlib import sha256

TEST_MATCHES = 2
LEAST_STILLS = 30  # of the match for development: fewer have too few balls to choose by

TEST = ("798b45", "744b27", *(f"G_20231125_TOP_B_2nd_{clip}" for clip in range(2, 7)))
DEVELOPMENT = ("08fd33", "G_20231125_TOP_B_2nd_1")
HELD_OUT = (*TEST, *DEVELOPMENT)  # prefixes of names that no training sees


def split_of(stills: Mapping[str, int]) -> tuple[tuple[str, ...], str]:
    """Return the matches for the test and the one for development, by number of stills of each.

    >>> split_of({"a": 40, "b": 40, "c": 12, "d": 33})
    (('d', 'c'), 'b')
    """
    order = sorted(stills, key=lambda match: sha256(match.encode()).hexdigest())
    rest = order[TEST_MATCHES:]
    return tuple(order[:TEST_MATCHES]), next(m for m in rest if stills[m] >= LEAST_STILLS)
