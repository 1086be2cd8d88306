"""Every wrong input of the catalogue is refused as recorded: status, words, one line."""

from collections.abc import Mapping

import pytest

from tests.refusals.catalogue import Case, Refusal, cases, lost, ordered, play, recorded, words_of

CASES = cases()
RECORDED = recorded()


@pytest.fixture(scope="module")
def answers() -> Mapping[str, Refusal]:
    """Return the answers of the command line to all cases; two graphs run meanwhile."""
    return play(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_a_wrong_input_is_refused_in_one_sentence_with_the_recorded_words(
    case: Case, answers: Mapping[str, Refusal]
) -> None:
    now = answers[case.case]

    gone = list(lost(case, RECORDED[case.case], now))

    assert gone == [], f"before: {RECORDED[case.case]['said']}\nnow: {now.sentence}"


def test_the_recorded_cases_are_those_of_the_catalogue_and_all_are_refusals() -> None:
    assert list(RECORDED) == [case.case for case in CASES]
    assert {was["exit"] for was in RECORDED.values()} <= {1, 2}
    assert all(was["said"] for was in RECORDED.values())


def test_a_lost_place_suggestion_or_status_is_found() -> None:
    was = {"exit": 2, "said": "fovea: a.yaml:7: eye.rat: no such setting, did you mean 'rate'?"}
    said = "fovea: a.yaml: no such setting, did you mean 'rate'?"
    case = Case(case="c")

    assert list(lost(case, was, Refusal(2, was["said"], was["said"]))) == []
    assert list(lost(case, was, Refusal(1, said, said))) == [
        "expected exit status 2, got 1", "a.yaml:7: not said any more", "eye.rat: not said any more"
    ]  # fmt: skip
    explained = Case(case="c", renamed={"a.yaml:7": "a.yaml", "eye.rat": ""})
    assert list(lost(explained, was, Refusal(2, said, said))) == []


@pytest.mark.parametrize(
    ("status", "whole"),
    [
        (0, ""),
        (1, ""),
        (-9, ""),
        (1, "Traceback (most recent call last):\n  …\nfovea: no\n"),
        (2, "fovea: no\nfovea: and no\n"),
        (3, "fovea: no\n"),
    ],
)
def test_success_silence_a_traceback_and_two_sentences_are_no_refusal(
    status: int, whole: str
) -> None:
    assert not Refusal(status, "fovea: no", whole).is_one


def test_words_of_a_sentence_are_its_names_numbers_and_suggestions() -> None:
    assert words_of("fovea: g.yaml:7: the `a.b`: expected 1 to 64, got 65") == {
        "g.yaml:7", "a.b", "expected", "1", "64", "got", "65",
    }  # fmt: skip


def test_a_graph_in_capitals_is_put_where_its_command_line_expects_it() -> None:
    words = ["logs", "LIVE", "work", "-n", "3"]

    assert ordered(words, node_first=True) == ["logs", "work", "-n", "3", "--graph", "live"]
    assert ordered(words, node_first=False) == ["logs", "live", "work", "-n", "3"]
    assert ordered(["run", "LIVE"], node_first=True) == ["run", "LIVE"]
