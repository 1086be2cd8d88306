"""`fovea check` tells whether a graph can work here, and refuses what cannot with the figures."""

import json
import secrets
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.commands import command

FOVEA = (sys.executable, "-m", "pipeline.entry")
SQUARE = "tests.drivers.moving_square:MovingSquare"
VIRTUAL = ["check", "tracking", "--source", "virtual_board"]
GRAPH = f"""\
nodes:
  capture:
    operator: operators.capture:Capture
    settings:
      options: {{scene: "{SQUARE}", size_px: [640, 384], rate_hz: 25, context_scale: 0.25}}
  small:
    operator: operators.downsample:Downsample
    inputs: {{frame: capture.context}}
    settings: {{width_px: 120}}
  count:
    operator: tests.samples:Count
    inputs: {{frame: small}}
  glance:
    operator: tests.samples:Count
    inputs: {{frame: capture.roi}}
"""


def planned(*words: str) -> tuple[int, dict[str, Any], str]:
    """Return exit status, the plan of the JSON, and what was said beside it."""
    done = command(*words, "--json")
    return done.returncode, json.loads(done.stdout)["plan"], done.stderr


def board(profile: str, depth: str, *more: str) -> list[str]:
    changes = [f"backend_options.profile={profile}", f"pixel_format=bayer_rggb{depth}", *more]
    # its frames need developing, which does not matter to the link
    return [*VIRTUAL, *(word for change in changes for word in ("--set", f"capture.{change}"))]


def test_a_graph_that_fits_has_its_tables_and_status_0() -> None:
    done = command("check", "tracking")

    assert done.returncode == 0, done.stderr
    for words in ("streams", "480x270", "USB 3.0", "frame pools", "Tp = 16", "CPU: no profile"):
        assert words in done.stdout


@pytest.mark.parametrize(
    ("depth", "limit", "status", "verdict"),
    [
        ("8", "0", 0, "fits"),
        ("10p", "0", 2, "marginal"),  # the board itself says 400 MB/s, which `run` refuses as well
        ("10p", "450000000", 0, "marginal"),
        ("16", "0", 2, "does not fit"),
    ],
)
def test_the_board_of_the_paper_is_judged_without_being_opened(
    depth: str, limit: str, status: int, verdict: str
) -> None:
    found = planned(*board("paper-live", depth, f"link_bytes_per_s={limit}"), "--link", "usb3.0")

    assert found[0] == status, found[2]
    assert found[1]["links"][0]["verdicts"]["usb3.0"] == verdict
    assert bool(found[1]["refusals"]) == (status == 2)
    assert bool(found[1]["warnings"]) == (verdict == "marginal")


def test_a_refusal_is_the_last_line_and_one_sentence() -> None:
    done = command(*board("paper-live", "16"))

    assert done.returncode == 2
    assert done.stderr == (
        "fovea: capture: link: expected up to 400 MB/s over the device's link, got 703: 2040x1148 "
        "bayer_rggb16 at 30 Hz + 4080x2296 bayer_rggb16 at 30 Hz; at most 17 Hz\n"
    )
    assert "does not fit" in done.stdout


def test_plans_that_end_before_the_read_out_of_the_prototype_are_refused() -> None:
    status, plan, said = planned(*board("paper-prototype", "8", "mode=record"))

    assert status == 2
    assert [row["frames"] for row in plan["delays"][0]["rows"]] == [28]
    assert said.startswith("fovea: dispatch: delay: expected plans of more than 28 frames")


def test_an_asked_sensor_tells_what_its_settings_leave_out(tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(GRAPH.replace("size_px: [640, 384], rate_hz: 25, ", ""))

    closed, asked = planned("check", str(path)), planned("check", str(path), "--ask")

    assert closed[1]["notes"] == [f"capture: {SQUARE} is not opened for its size_px and rate_hz"]
    assert closed[1]["streams"][0]["size_px"] is None
    assert asked[1]["streams"][0]["size_px"] == [80, 48]
    assert (closed[1]["asked"], asked[1]["asked"]) == (False, True)
    assert asked[1]["streams"][0]["rate_hz"] == 100


def test_a_sensor_that_cannot_be_asked_is_one_sentence() -> None:
    words = ["--source", "video", "--set", "capture.path=/none.mp4", "--ask"]

    done = command("check", "tracking", *words)

    assert done.returncode == 1
    assert done.stderr.startswith("fovea: capture: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("option", [["--ask"], ["--link", "usb2"]])
@pytest.mark.parametrize("words", [["tracking", "--no-import"], ["--schema"], []])
def test_options_of_the_plan_go_with_a_graph(words: list[str], option: list[str]) -> None:
    done = command("check", *words, *option)

    assert done.returncode == 2
    assert "--profile, --link, --ask: go with a GRAPH" in done.stderr


def test_a_run_of_another_graph_is_no_profile(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    report = {"graph": "other", "clock": "realtime", "duration_s": 1.0, "edges": [], "stages": []}
    path.write_text(json.dumps(report))

    done = command("check", "tracking", "--profile", str(path))

    assert done.returncode == 2
    assert "expected a run of tracking, got one of 'other'; `fovea run GRAPH" in done.stderr
    assert done.stdout == ""


@pytest.mark.lengthy
def test_a_recorded_run_has_the_pools_that_were_planned_and_tells_the_rest(
    tmp_path: Path,
) -> None:
    path, file = tmp_path / "graph.yaml", tmp_path / "profile.json"
    path.write_text(f"name: planned-{secrets.token_hex(3)}\n{GRAPH}")
    run = [*FOVEA, "run", str(path), "--duration-s", "4", "--report", str(file)]
    assert subprocess.run(run, check=False, capture_output=True, timeout=120).returncode == 0
    recorded = json.loads(file.read_text())["profile"]

    status, plan, said = planned("check", str(path), "--profile", str(file))

    assert status == 0, said
    predicted = {row["output"]: row["pool_bytes"] for row in plan["pools"]["rows"]}
    made = {name.removesuffix(".out"): size for name, size in recorded["pools"].items()}
    assert made == {name: size for name, size in predicted.items() if size}
    assert set(made) == {"capture.context", "capture.roi", "small"}
    cpu = plan["cpu"]
    assert {row["process"] for row in cpu["rows"]} == {"capture", "small", "count", "glance"}
    assert (cpu["rate_hz"], cpu["missing"], cpu["changed"]) == (25, [], [])
    assert cpu["cores"] > 0

    fast = planned("check", str(path), "--profile", str(file), "--set", "capture.rate_hz=10000")

    assert fast[1]["cpu"]["changed"] == ["capture"]
    assert fast[1]["cpu"]["cores"] == pytest.approx(400 * cpu["cores"], rel=1e-6)
