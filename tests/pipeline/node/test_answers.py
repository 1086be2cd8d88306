"""Every node answers four questions, singly or by a wildcard, and reports that it hangs."""

import re
import signal
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import Frame, Operator, SettingsError
from pipeline.client.find import find
from pipeline.codec import fingerprint
from pipeline.commands import carry_out, commands_of
from pipeline.node.answers import respond
from pipeline.node.interface import interface
from pipeline.protocol.codec import Refused, decode, encode
from pipeline.protocol.questions import Command, Health, Outcome
from pipeline.run.supervisor import Supervisor
from pipeline.testing import header
from tests.sample_graphs import LOOP, go, handled, plan_of, send_signal, together, until, wait_for
from tests.samples import Pass, WorkSettings


def work(*seqs: int) -> Pass:
    operator = Pass(WorkSettings(hold=3))
    operator.open()
    for seq in seqs:
        operator.on_frame(
            Frame(header=header(seq), pixels=np.zeros((2, 2, 3), np.uint8), window=(0, 0, 2, 2))
        )
    return operator


class Returning(Operator[Any, None]):
    """Has one command, which returns the settings."""

    commands = ("ret",)

    def do_ret(self) -> Any:
        return self.settings


def commanded(operator: Operator[Any, Any], node: str = "work") -> Callable[[Command], Outcome]:
    """Return the function with which a node answers a command."""
    return lambda c: Outcome(answer=carry_out(node, operator, c.command, c.arguments))


def test_a_command_is_done_and_answered() -> None:
    done = carry_out("work", work(1, 2, 3), "recall", {"last": 2, "doubled": True})

    assert done == {"held": [4, 6]}


@pytest.mark.parametrize(
    ("command", "arguments", "said"),
    [
        ("recal", {}, r"work: no command recal, did you mean 'recall'\?"),
        ("open", {}, "work: no command open; there is recall, break_down"),
        ("recall", {"lst": 2}, r"work\.recall\.lst: no such argument, did you mean 'last'\?"),
        ("recall", {"last": "2"}, r"work\.recall\.last: input should be a valid integer, got '2'"),
        ("recall", {"last": 0}, r"work\.recall\.last: must be at least 1, got 0"),
    ],
)
def test_a_wrong_command_is_refused_with_the_reason(
    command: str, arguments: dict[str, Any], said: str
) -> None:
    with pytest.raises(SettingsError, match=said):
        carry_out("work", work(1), command, arguments)


@given(st.binary(max_size=60))
def test_noise_is_refused_as_a_command(noise: bytes) -> None:
    answers: list[bytes] = []

    respond("work", Command, noise, commanded(work(1)), answers.append)

    assert decode(Refused, answers[0]).reason.startswith("not a Command")


def test_an_exception_in_a_command_is_sent_as_the_answer_and_raised() -> None:
    told, answers = encode(Command("break_down")), list[bytes]()

    with pytest.raises(ValueError, match="told to break"):
        respond("work", Command, told, commanded(work()), answers.append)

    said = decode(Refused, answers[0]).reason
    assert re.search(
        r"it failed and restarts: .+samples\.py:[0-9]+: ValueError: told to break", said
    )


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (np.zeros(3), ", got ndarray"),
        ([], ", got list"),
        (0, ", got int"),
        ({"mean": np.zeros(3)}, ": Object of type ndarray is not JSON serializable"),
    ],
    ids=["array", "list", "number", "array within"],
)
def test_what_is_no_mapping_of_plain_values_is_refused_and_the_operator_goes_on(
    returned: Any, said: str
) -> None:
    operator, answers = Returning(returned), list[bytes]()

    respond("x", Command, encode(Command("ret")), commanded(operator, "x"), answers.append)

    assert decode(Refused, answers[0]).reason == f"x.ret: expected a mapping of plain values{said}"


@pytest.mark.parametrize("returned", [None, {}, MappingProxyType({"a": (1, 2.5)})])
def test_a_command_answers_with_none_or_any_mapping(returned: Any) -> None:
    answer = carry_out("x", Returning(returned), "ret", {})

    assert answer == ({"a": [1, 2.5]} if returned else {})


def test_commands_name_methods_whose_arguments_have_types() -> None:
    class Mute(Operator[WorkSettings, None]):
        commands = ("recal",)

    class Untyped(Operator[WorkSettings, None]):
        commands = ("recall",)

        def do_recall(self, last) -> None:  # type: ignore[no-untyped-def]
            pass

    with pytest.raises(SettingsError, match=r"Mute\.commands: expected a method do_recal"):
        commands_of(Mute)
    with pytest.raises(SettingsError, match=r"do_recall\(last\): expected a type"):
        commands_of(Untyped)


def test_the_interface_names_ports_by_their_fingerprint() -> None:
    found = interface("work", Pass)

    assert found.inputs["frame"].fingerprint == fingerprint(Frame).hex()
    assert found.outputs["out"].message == "Frame"
    assert found.live == ("every", "hold")
    assert found.settings["properties"]["every"]["type"] == "integer"
    assert set(found.commands["recall"]["properties"]) == {"last", "doubled"}


def test_a_running_graph_answers_every_question(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, changes=("work.hold=4",))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 3)

        fleet = find(plan.name).health()
        held = find(plan.name).command("work", "recall", {"last": 2}).answer["held"]
        shown = find(plan.name).schema("pair")

        assert list(fleet) == ["ticker", "work", "pair", "steer"]
        for node, health in fleet.items():
            assert health is not None
            assert (health.pid, health.problem) == (supervisor.pid(node), "")
            assert health.handled > 0
            assert 0 < health.own_mb < 500
        assert held == sorted(set(held))
        assert len(held) == 2
        assert list(shown.inputs) == ["left", "right"]
        supervisor.finish()

    assert go(plan, 0, during)["failure"] == ""


def test_a_node_that_hangs_reports_it_and_a_frozen_one_does_not_answer(tmp_path: Path) -> None:
    text = together(LOOP, "ticker", "pair")
    text = text.replace("  work:\n", "  work:\n    stall_s: 1\n")
    text = text.replace("frame: ticker.context", "frame: {from: ticker.context, keep: every}")
    plan = plan_of(tmp_path, text, changes=("work.hang_at=5",))

    with Supervisor(plan) as supervisor:
        supervisor.start()
        wait_for(supervisor, lambda: supervisor.ledger.nodes[1].last_seq >= 5)
        send_signal(supervisor, "steer", signal.SIGSTOP)
        fleet: dict[str, Health | None] = {}

        def has_problem() -> bool:  # the supervisor does not tick meanwhile and replaces neither
            fleet.update(find(plan.name).health())
            return bool(fleet["work"] and fleet["work"].problem)

        until(has_problem)
        assert fleet["work"] is not None
        assert "work has worked on frame" in fleet["work"].problem
        assert fleet["steer"] is None
