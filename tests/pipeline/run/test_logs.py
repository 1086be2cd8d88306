"""Reading on in a log: every line once, also equal ones, whole lines only."""

import secrets
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.fleet.agent import MOST_LINES
from pipeline.protocol.codec import MOST_BYTES, decode_answer, encode
from pipeline.protocol.fleet import Log
from pipeline.run import logs
from pipeline.run.logs import log_lines, log_part
from pipeline.run.rundir import folder_of

LINES = st.lists(st.sampled_from(["", "again", "ä", "x" * 40]), max_size=6)


@pytest.fixture(scope="module")
def graph() -> Iterator[str]:
    name = f"logs-{secrets.token_hex(3)}"
    folder = folder_of(name)
    folder.mkdir(mode=0o700)
    yield name
    (folder / "work.log").unlink()
    folder.rmdir()


def log_of(graph: str) -> Path:
    return folder_of(graph) / "work.log"


@pytest.mark.lengthy
@given(LINES, st.lists(LINES, max_size=5), st.integers(1, 3))
def test_who_reads_on_gets_every_line_once(
    graph: str, first: list[str], later: list[list[str]], count: int
) -> None:
    path = log_of(graph)
    path.write_text("".join(f"{line}\n" for line in first))
    found, end = log_part(graph, "work", 100)
    read = [*found]

    for more in later:
        with path.open("a") as file:
            file.writelines(f"{line}\n" for line in more)
        found, end = log_part(graph, "work", count, end)
        read += found
    while found := log_part(graph, "work", count, end)[0]:
        end = log_part(graph, "work", count, end)[1]
        read += found

    assert read == [*first, *(line for more in later for line in more)]


def test_a_line_that_is_still_written_is_told_once_it_is_whole(graph: str) -> None:
    log_of(graph).write_text("one\ntw")
    first, end = log_part(graph, "work", 9)
    log_of(graph).write_text("one\ntwo\n")

    assert first == ("one",)
    assert log_part(graph, "work", 9, end)[0] == ("two",)


def test_a_log_that_began_anew_is_read_from_its_beginning(graph: str) -> None:
    log_of(graph).write_text("a long line of the first run\n")
    _, end = log_part(graph, "work", 9)
    log_of(graph).write_text("new\n")

    assert log_part(graph, "work", 9, end)[0] == ("new",)


def test_a_log_is_followed_into_the_file_that_is_begun_when_it_is_full(graph: str) -> None:
    path = log_of(graph)
    path.write_text("one\n")
    followed = log_lines(graph, "work", 5, follow=True)
    found = [next(followed)]
    old = path.with_name(f"{path.name}.old")
    with path.open("a") as file:
        file.write("two\n")
        file.flush()
        path.replace(old)
        path.write_text("four\n")
        file.write("three\n")

    found += [next(followed) for _ in range(3)]

    followed.close()
    old.unlink()
    assert found == ["one", "two", "three", "four"]


def test_a_log_that_is_emptied_is_followed_from_its_beginning(graph: str) -> None:
    path = log_of(graph)
    path.write_text("one\ntwo\n")
    followed = log_lines(graph, "work", 5, follow=True)
    found = [next(followed) for _ in range(2)]
    path.write_text("new\n")

    found.append(next(followed))

    followed.close()
    assert found == ["one", "two", "new"]


def test_no_lines_are_none(graph: str) -> None:
    log_of(graph).write_text("one\ntwo\n")

    assert log_part(graph, "work", 0) == ((), 8)
    assert log_part(graph, "work", 1) == (("two",), 8)


@pytest.mark.parametrize("begin", [None, 0])
@pytest.mark.parametrize("length", [10, 400, 2000])
def test_a_part_that_is_no_text_fits_into_an_answer_of_an_agent(
    graph: str, length: int, begin: int | None
) -> None:
    log_of(graph).write_bytes((b"\xff" * length + b"\n") * (MOST_BYTES // length))

    lines, end = log_part(graph, "work", MOST_LINES, begin)

    assert decode_answer(Log, encode(Log(lines, end))).lines == lines != ()


def test_a_very_long_log_is_read_in_parts(graph: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "MOST_PART_BYTES", 10)
    log_of(graph).write_text("one\ntwo\nthree\nfour\n")

    last, end = log_part(graph, "work", 9)
    begin, middle = log_part(graph, "work", 9, 0)

    assert (last[-1], end) == ("four", 19)
    assert (begin, middle) == (("one", "two"), 8)
    log_of(graph).write_text("a line of more than ten letters\n")
    assert log_part(graph, "work", 9, 0) == (("a line of ",), 10)
