"""The split of the labelled stills follows its rule."""

from operators.training.splits import DEVELOPMENT, HELD_OUT, TEST, split_of


def test_the_split_follows_its_rule_and_shares_no_match() -> None:
    counts = {
        "08fd33": 33, "121364": 12, "2e57b9": 40, "40cd38": 17, "42ba34": 32,
        "538438": 44, "54745b": 16, "55c9d1": 6, "744b27": 37, "798b45": 34,
    }  # fmt: skip

    test, development = split_of(counts)

    assert set(test) <= set(TEST)
    assert development in DEVELOPMENT
    assert not set(TEST) & set(DEVELOPMENT)
    assert set(HELD_OUT) == {*TEST, *DEVELOPMENT}
