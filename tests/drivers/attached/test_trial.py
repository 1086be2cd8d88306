"""`fovea sensors test`: a verdict for every check, in a process of its own."""

import json
from collections.abc import Sequence
from typing import Any

import pytest

from drivers.attached.measurement import Run, accounts, effect, rate, run_in_real_time
from drivers.attached.recording import RECORDING, check_previews_show_the_whole_field
from drivers.attached.report import without_credentials
from drivers.attached.subject import subject_of
from drivers.attached.trial import MEASURED, OPENS, REAL_TIME, TITLES
from drivers.contract import SKIPPED, ContractBroken, title
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from pipeline.contract import RATE
from pipeline.errors import FoveaError
from tests.commands import command
from tests.drivers.attached import wrong_sensors as wrong

SQUARE = "tests.drivers.moving_square:MovingSquare"
WRONG = "tests.drivers.attached.wrong_sensors"
SMALL = (
    "--set", f"backend_options.scene={SQUARE}", "--set", "backend_options.size_px=[320, 192]",
    "--set", "rate_hz=10", "--seconds", "1.5",
)  # fmt: skip


def settings(**values: Any) -> SimulatedSensorSettings:
    return SimulatedSensorSettings(scene=SQUARE, **{"rate_hz": 100.0, "loop": True, **values})


def verdicts(sensor: str, *words: str) -> tuple[int, dict[str, Any]]:
    """Test a sensor of `wrong_sensors` over the moving square; return status and answer."""
    scene = ("--set", f"scene={SQUARE}", "--set", "loop=true", "--set", "rate_hz=100")
    done = command("sensors", "test", f"{WRONG}:{sensor}", *scene, "--json", *words)
    return done.returncode, json.loads(done.stdout)


def wrongs(answer: dict[str, Any]) -> dict[str, str]:
    return {c["check"]: c["why"] for c in answer["checks"] if c["verdict"] == "wrong"}


def test_a_virtual_board_passes_with_its_figures() -> None:
    done = command("sensors", "test", "virtual", *SMALL, "--json")

    answer = json.loads(done.stdout)
    found = {check["check"]: check for check in answer["checks"]}
    assert done.returncode == 0, answer
    assert answer["sensor"] == "drivers.usb:DualStreamBoard"
    assert tuple(found) == TITLES
    assert answer["passed"] is True
    assert found[OPENS]["figures"]["field_px"] == [320, 192]
    assert found["the rate is kept"]["figures"]["asked_hz"] == 10.0
    assert found["commands take effect"]["figures"]["told"] == 1
    assert found["every frame is accounted for"]["figures"]["delivered"] > 10


def test_a_board_that_records_is_asked_what_holds_for_recording() -> None:
    done = command(
        "sensors", "test", "virtual", *SMALL, "--json", "--set", "mode=record",
        "--set", "backend_options.profile=paper-prototype", "--set", "rate_hz=30",
        "--set", "backend_options.source_options={length: null}",
    )  # fmt: skip

    answer = json.loads(done.stdout)
    found = {check["check"]: check for check in answer["checks"]}
    assert done.returncode == 0, answer
    assert tuple(found) == (OPENS, *map(title, RECORDING))
    assert found["previews show the whole field"]["figures"] == {"frames_per_preview": 4.0}
    assert found["a plan is recorded frame by frame"]["figures"]["frames"] == 8


def test_a_live_sensor_does_not_pass_as_one_that_records() -> None:
    def make() -> SimulatedSensor:
        return SimulatedSensor(settings())

    with pytest.raises(ContractBroken, match="expected no ROI without a plan"):
        check_previews_show_the_whole_field(make)


def test_the_verdict_is_read_line_by_line_and_is_the_exit_status() -> None:
    done = command("sensors", "test", f"{WRONG}:Stretched", "--set", f"scene={SQUARE}",
                   "--seconds", "0.2")  # fmt: skip

    lines = done.stdout.splitlines()
    assert done.returncode == 1
    assert lines[0].startswith(f"ok      {OPENS}")
    assert "roi_px" in lines[0]
    assert lines[1].startswith("wrong   frames say what they show")
    assert "size of the ROI's window: expected (80, 48), got (78, 48)" in lines[1]
    assert lines[-1].endswith("the contract is not kept")
    assert len(lines) == len(TITLES) + 1


def test_a_sensor_that_never_delivers_is_ended_at_the_limit() -> None:
    status, answer = verdicts("Silent", "--timeout-s", "4", "--seconds", "0.1")

    assert status == 1
    assert wrongs(answer) == {"frames say what they show": "no answer within 4.1 s"}
    assert answer["passed"] is False


def test_a_library_that_crashes_is_a_verdict() -> None:
    status, answer = verdicts("Crashing")

    assert status == 1
    assert wrongs(answer) == {"frames say what they show": "the library crashed (SIGSEGV)"}


def test_a_sensor_that_cannot_be_opened_is_asked_no_more() -> None:
    status, answer = verdicts("Closed")

    assert (status, wrongs(answer)) == (1, {OPENS: "closed: expected a key, got none"})
    assert len(answer["checks"]) == 1


def test_a_mistake_in_a_driver_is_a_verdict_of_each_check() -> None:
    status, answer = verdicts("Buggy", "--seconds", "0.1")

    assert status == 1
    assert set(wrongs(answer).values()) == {"KeyError: 'exposure'"}
    assert REAL_TIME in wrongs(answer)
    assert not set(MEASURED) & {check["check"] for check in answer["checks"]}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing"], "'nothing': expected usb:SERIAL, genicam:ID, /dev/videoN, a URL, virtual, "),
        (["virtual", "--set", "rate"], "--set rate: expected OPTION=VALUE"),
        (["virtual", "--set", "rat_hz=5"], "options.rat_hz: no such setting, did you mean"),
        (["virtual", "--set", "rate_hz=-1"], "options.rate_hz: expected 0 to 10000, got -1"),
        (["virtual", "--set", "rate_hz.a=1"], "rate_hz: expected a mapping to change, got 30"),
        (["nowhere:Sensor"], "sensor: nowhere:Sensor cannot be imported: "),
        (["json:dumps"], "sensor: expected a DualStreamSensor, got json:dumps"),
        (["none.yaml"], "none.yaml"),
    ],
)  # fmt: skip
def test_what_is_no_sensor_is_refused_in_one_sentence(words: Sequence[str], said: str) -> None:
    done = command("sensors", "test", *words)

    assert done.returncode == 2
    assert done.stderr.startswith("fovea: ")
    assert said in done.stderr, done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("name", "sensor", "options"),
    [
        ("usb:S1", "drivers.usb:DualStreamBoard", {"serial": "S1"}),
        ("virtual", "drivers.usb:DualStreamBoard", {"rate_hz": 30}),
        ("soccer", "drivers.simulated:SimulatedSensor", {"scene": "soccer"}),
        ("tests.drivers.attached.wrong_sensors:Silent", f"{WRONG}:Silent", {}),
    ],
)
def test_a_name_is_a_sensor_with_the_settings_of_its_source_file(
    name: str, sensor: str, options: dict[str, Any]
) -> None:
    with subject_of(name) as found:
        assert found.sensor == sensor
        assert options.items() <= dict(found.options).items()


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("/dev/video7", {"device": "/dev/video7"}),
        ("rtsp://camera.local/one", {"url": "rtsp://camera.local/one"}),
        ("drivers.cameras:Webcam", {}),
    ],
)
def test_a_plain_camera_is_tested_as_a_sensor_in_software(
    name: str, camera: dict[str, str]
) -> None:
    with subject_of(name, ["camera_options.read_timeout_s=2"]) as found:
        assert found.sensor == "drivers.cameras:CameraSensor"
        assert {**camera, "read_timeout_s": 2}.items() <= found.options["camera_options"].items()
        assert found.make().settings_type.__name__ == "CameraSensorSettings"


@pytest.mark.parametrize("as_json", [True, False])
@pytest.mark.parametrize("secret", ['me:se"secret@127.0.0.1:1/one', "127.0.0.1:1/one?pwd=secret"])
def test_credentials_of_an_address_are_not_shown(as_json: bool, secret: str) -> None:
    address = f"rtsp://{secret}"
    limits = ("--set", "camera_options.open_timeout_s=0.2", "--timeout-s", "30")

    done = command("sensors", "test", address, *limits, *(["--json"] if as_json else []))

    assert done.returncode == 1
    assert "rtsp://127.0.0.1:1/one" in done.stdout
    assert "secret" not in done.stdout + done.stderr


def test_credentials_of_a_pipeline_are_not_shown_either() -> None:
    options = {"pipeline": "rtspsrc user-pw=secret ! appsink", "also": ["http://me:secret@cam/"]}

    assert without_credentials({"camera_options": options})["camera_options"] == {
        "pipeline": "GStreamer pipeline rtspsrc ! appsink",
        "also": ["http://cam/"],
    }


def test_names_of_nothing_are_refused() -> None:
    for name in ("", "usb:", "genicam:", "nothing", "-", "a b"):
        with pytest.raises(FoveaError), subject_of(name) as found:
            found.make()


def ran(seqs: Sequence[int], *, period_ms: float = 10.0, **figures: Any) -> Run:
    """A run whose exposures came at their time; figures are those of the sensor's summary."""
    stamps_ns = [round(1e6 * period_ms * seq) for seq in seqs]
    run = Run(lead_frames=1, reads_regions=True, seqs=list(seqs), stamps_ns=stamps_ns)
    run.streams, run.summary = {"one"}, figures
    return run


def test_a_run_in_real_time_is_measured() -> None:
    run = run_in_real_time(lambda: SimulatedSensor(settings()), 0.8)

    assert run.summary["rate"]["asked_hz"] == 100.0
    # a busy machine may be a frame late each time; a plan never works earlier than it is told
    assert effect(run)["told"] == 1 <= effect(run)["least"]
    figures = accounts(run)
    assert figures["delivered"] == len(run.seqs) > 2
    assert figures["dropped"] <= figures["accounted"]


def test_the_rate_is_that_of_the_stamps() -> None:
    asked = {RATE: {"asked_hz": 100.0, "achieved_hz": 100.0}}

    assert rate(ran(range(50), **asked)) == {
        "asked_hz": 100.0, "measured_hz": 100.0, "frames": 45, "longest_gap_ms": 10.0
    }  # fmt: skip
    assert rate(ran([0, 400, *range(401, 450)], **asked))["measured_hz"] == 100.0  # it settles
    assert rate(ran([0, 1, 4]))["asked_hz"] == 0.0
    for run, said in (
        (
            ran(range(50), period_ms=11, **asked),
            "rate: expected 100 Hz, got 90.91 Hz with a gap of 11 ms",
        ),
        (ran([0]), "rate: expected at least two frames, got 1"),
        (ran([0, 0]), "stamps: expected each after the one before, got one that is not"),
    ):
        with pytest.raises(ContractBroken, match=said):
            rate(run)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (
            {"exposed": 4, "skipped": 2, "late": 2, "elapsed": 7},
            "a reason for 3 missing frames, got",
        ),
        ({"exposed": 5, "skipped": 3}, "expected 4 exposed as were read, got 5"),
        ({}, "expected 4 exposed as were read, got None"),
    ],
)
def test_missing_frames_need_a_reason(told: dict[str, int], said: str) -> None:
    with pytest.raises(ContractBroken, match=said):
        accounts(ran([0, 1, 5, 6], frames=told))


@pytest.mark.parametrize(
    "told", [{"exposed": 4, "lost": 2, "overrun": 1}, {"exposed": 4, "late": 3, "incomplete": 0}]
)
def test_losses_of_any_name_are_reasons(told: dict[str, int]) -> None:
    assert accounts(ran([0, 1, 5, 6], frames=told)) == {
        "delivered": 4, "dropped": 3, "accounted": 3
    }  # fmt: skip


def test_commands_without_effect_are_counted() -> None:
    deaf = run_in_real_time(lambda: wrong.Disobedient(settings()), 0.7)
    eager = run_in_real_time(lambda: wrong.Eager(settings()), 0.7)
    blind = run_in_real_time(lambda: SimulatedSensor(settings(strategy="spatial")), 0.2)
    some = ran(range(9))
    some.effects, some.without_effect = [1, 1], 1

    with pytest.raises(ContractBroken, match="commands: expected an effect within 33 frames, got"):
        effect(deaf)
    with pytest.raises(ContractBroken, match="lead_frames: expected effects after at least 3"):
        effect(eager)
    with pytest.raises(ContractBroken, match="expected 3 to take effect, got 1 that did not and 0"):
        effect(some)
    assert effect(blind) == {SKIPPED: "it reads no region"}
