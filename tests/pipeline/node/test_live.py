"""Live settings change between two frames of a running graph, or are refused with a reason."""

import re
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import Operator, RunError, SettingsError
from pipeline.client.find import find
from pipeline.contract import live_of
from pipeline.node.answers import respond
from pipeline.node.live import Live, kept
from pipeline.protocol.codec import Refused, decode, encode
from pipeline.protocol.questions import ConfigQuestion
from pipeline.run.inline import InlineRunner
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import LOOP, go, handled, plan_of, send_signal, together, wait_for
from tests.samples import Pass, WorkSettings


def work(file: Path | None = None) -> tuple[Pass, Live]:
    operator = Pass(WorkSettings())
    return operator, Live("work", operator, {}, file)


def test_a_live_setting_changes_and_the_others_stay() -> None:
    operator, live = work()

    live.change({"every": 3})
    live.change({"hold": 2})

    assert operator.settings == WorkSettings(every=3, hold=2)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"evry": 2}, r"work\.evry: no such setting, did you mean 'every'\?"),
        ({"every": "often"}, r"work\.every: input should be a valid integer, got 'often'"),
        ({"every": 0}, r"work\.every: must be at least 1, got 0"),
        ({"sleep_s": 1.0}, r"work\.sleep_s: cannot change while the node runs; every, hold can"),
        ({"hold": 10}, r"work\.hold: no room for more than 9 pictures"),
        ({"every": 2, "sleep_s": 1.0}, "cannot change"),
    ],
)
def test_a_refused_change_raises_with_the_reason_and_changes_nothing(
    changes: dict[str, Any], said: str
) -> None:
    operator, live = work()
    live.change({"every": 5})

    with pytest.raises(SettingsError, match=said):
        live.change(changes)

    assert operator.settings == WorkSettings(every=5)
    live.change({"hold": 1})  # the refused change does not come back with the next one
    assert operator.settings == WorkSettings(every=5, hold=1)


def test_what_changed_is_kept_in_the_file_and_what_was_refused_is_not(tmp_path: Path) -> None:
    file = tmp_path / "work.live"
    _, live = work(file)
    assert kept(file) == {}

    live.change({"every": 3})
    with pytest.raises(SettingsError):
        live.change({"every": 0})

    assert kept(file) == {"every": 3}


def test_what_cannot_be_kept_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    operator, live = work(tmp_path / "gone" / "work.live")

    with pytest.raises(SettingsError, match=r"work: cannot be kept: .*No such file"):
        live.change({"every": 3})

    assert operator.settings == WorkSettings()


@given(st.binary(min_size=1, max_size=60))
def test_noise_is_refused_and_changes_nothing(noise: bytes) -> None:
    operator, live = work()
    answers: list[bytes] = []

    respond("work", ConfigQuestion, noise, live.configure, answers.append)

    assert decode(Refused, answers[0]).reason.startswith("not a ConfigQuestion")
    assert operator.settings.every == 1
    assert operator.settings.sleep_s == 0


def test_an_exception_in_a_change_is_sent_as_the_answer_and_raised() -> None:
    _, live = work()
    told = encode(ConfigQuestion({"hold": -1}))
    answers: list[bytes] = []

    with pytest.raises(ValueError, match="told to break"):
        respond("work", ConfigQuestion, told, live.configure, answers.append)

    said = decode(Refused, answers[0]).reason
    assert re.search(
        r"it failed and restarts: .+samples\.py:[0-9]+: ValueError: told to break", said
    )


def test_live_names_settings() -> None:
    class Wrong(Operator[WorkSettings, None]):
        live = ("evry",)

    with pytest.raises(SettingsError, match=r"Wrong\.live: expected names of settings, got 'evry'"):
        live_of(Wrong)


def test_in_line_a_change_holds_from_the_next_frame_on(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep")
    answered: list[int] = []

    with InlineRunner(
        plan, watch=lambda name, m: answered.append(m.header.seq) if name == "work.out" else None
    ) as runner:
        for seq in runner.run(12):
            if seq == 5:
                effective = runner.change("work", {"every": 4})

    assert effective["every"] == 4
    assert answered == [0, 1, 2, 3, 4, 5, 8]


def test_in_line_an_unknown_node_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with (
        InlineRunner(plan_of(tmp_path, LOOP, clock="lockstep")) as runner,
        pytest.raises(RunError, match="no node wrk, did you mean 'work'"),
    ):
        runner.change("wrk", {})


def test_a_running_node_keeps_its_changed_settings_across_a_crash(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, together(LOOP, "pair", "steer"))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 3)
        assert find(plan.name).configure("work", {"every": 2}).settings["every"] == 2
        assert find(plan.name).configure("ticker", {"rate_hz": 90}).settings["rate_hz"] == 90
        with pytest.raises(RunError, match="must be at least 1"):
            find(plan.name).configure("work", {"every": 0})
        send_signal(supervisor, "work", signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.restarts.get("work") == 1)
        index = plan.node("work").index
        wait_for(supervisor, lambda: supervisor.ledger.nodes[index].condition == "waiting")

        answer = find(plan.name).configure("work", {})

        assert answer.settings["every"] == 2
        assert answer.live == ("every", "hold")
        supervisor.finish()

    report = go(plan, 0, during)

    assert report["restarts"] == {"work": 1}
    assert report["failure"] == ""


def test_the_next_run_begins_with_the_settings_of_its_graph(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "pair", "steer"))
    seen = []

    def change(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 1)
        seen.append(
            find(plan.name).configure("work", {"every": 7} if not seen else {}).settings["every"]
        )
        supervisor.finish()

    for _ in range(2):
        go(plan, 0, change)

    assert seen == [7, 1]


def test_a_node_or_graph_that_does_not_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "pair", "steer"))

    with Supervisor(plan) as supervisor:
        supervisor.start()
        with pytest.raises(RunError, match=r"no node stear, did you mean 'steer'\?"):
            find(plan.name).configure("stear", {})
        with pytest.raises(RunError, match=rf"no graph {plan.name}x runs, did you mean"):
            find(f"{plan.name}x").configure("steer", {})
