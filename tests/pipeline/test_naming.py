"""Names become parts of paths and keys, so a plan with an invalid name is always refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from pipeline import GraphError
from pipeline.graph.plan import Plan
from pipeline.naming import LONGEST_NAME, check_name, is_name
from tests.sample_graphs import CHAIN, plan_of

NO_NAMES = (
    *["", ".", "..", "/etc", "../../x", "a/b", "a.b", "**", "a*", "$x", "#", "a?b", "a b", "-a"],
    *["a\0", "ä", "a\n", "@a", "x" * (LONGEST_NAME + 1)],
)


@pytest.mark.parametrize("text", NO_NAMES)
def test_what_could_leave_a_folder_or_mean_several_keys_is_no_name(text: str) -> None:
    assert not is_name(text)
    with pytest.raises(GraphError, match="here: expected up to 32 letters, digits, - and _, got"):
        check_name(text, "here")


@given(st.text())
def test_a_name_is_one_safe_part_of_a_path(text: str) -> None:
    if is_name(text):
        assert Path(text).name == text
        assert text.isascii()
        assert len(text) <= LONGEST_NAME


@pytest.mark.parametrize("value", [None, 5, b"a", ["a"], 10**400])
def test_only_texts_are_names_and_the_error_is_short(value: object) -> None:
    with pytest.raises(GraphError) as caught:
        check_name(value, "graph.name")

    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("text", NO_NAMES)
def test_no_plan_has_such_a_name_whatever_it_is_read_from(tmp_path: Path, text: str) -> None:
    plan = plan_of(tmp_path, CHAIN)
    adapter = TypeAdapter(Plan)
    written = adapter.dump_python(plan, mode="json")
    written["nodes"][0]["name"] = text

    with pytest.raises(GraphError):
        replace(plan, name=text)
    with pytest.raises(GraphError):
        replace(plan.nodes[0], name=text)
    with pytest.raises(GraphError):
        replace(plan.edges[0], output=text)
    with pytest.raises(GraphError):
        adapter.validate_python(written)
