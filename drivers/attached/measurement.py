"""Run a sensor in real time for a few seconds: rate, effect of commands and accounts out."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.commands import Window
from drivers.contract import SKIPPED, ContractBroken, Figures, Make, command, memory, running
from drivers.sensor import DualStreamSensor, Exposure
from pipeline.boxes import roi_window
from pipeline.contract import RATE

LEAST_RATE = 0.95  # share of the rate asked for that has to be kept
PATIENCE = 32  # frames beyond `lead_frames` in which a command has to take effect
SETTLING = 5  # first frames, which may be slow: neither rate nor commands are measured on them
PAUSE = 3  # frames between a command's effect and the next command
WITHIN = ("late",)  # counts that are part of `skipped`, where a sensor has that
NO_LOSSES = ("exposed", "elapsed")


@dataclass(kw_only=True)
class Run:
    """What a sensor did in real time."""

    lead_frames: int
    reads_regions: bool
    seqs: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    streams: set[str] = field(default_factory=set)
    effects: list[int] = field(default_factory=list)  # frames from what a command was made from
    without_effect: int = 0
    wrong_windows: int = 0  # a frame names the command, and shows another window
    summary: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class _Sent:
    made_from: int
    window: Window


class _Commands:
    """Sends the ROI from corner to corner, and counts the frames until it is there."""

    def __init__(self, sensor: DualStreamSensor, run: Run) -> None:
        self._sensor, self._run = sensor, run
        grid = sensor.capabilities().geometry
        ends = np.array([[0, 0], [grid.width_px, grid.height_px]], np.float32)
        self._corners = [roi_window(end, grid) for end in ends]
        self._sent: _Sent | None = None
        self._pause = 0

    def after(self, exposure: Exposure) -> None:
        """Look whether a command took effect, or send the next one."""
        run, sent, seq = self._run, self._sent, exposure.header.seq
        if sent is None:
            self._pause -= 1
            if self._pause <= 0:
                self._send(exposure)
            return
        if exposure.roi.command_seq == sent.made_from:
            run.effects.append(seq - sent.made_from)
            run.wrong_windows += exposure.roi.window != sent.window
        elif seq - sent.made_from < run.lead_frames + PATIENCE:
            return
        else:
            run.without_effect += 1
        self._sent, self._pause = None, PAUSE

    def _send(self, exposure: Exposure) -> None:
        header = exposure.header
        self._corners.reverse()
        window = self._corners[0]
        windows = [window] * (self._run.lead_frames + PATIENCE)
        self._sensor.set_rois(
            command(header.stream, made_from=header.seq, first=header.seq + 1, windows=windows)
        )
        self._sent = _Sent(made_from=header.seq, window=window)


def run_in_real_time(make: Make, duration_s: float) -> Run:
    """Read a sensor at its own rate and command it all the time; it may end before.

    The duration begins when the sensor has settled, or with the first frame of one that ends.
    """
    with running(make, realtime=True) as sensor:
        can = sensor.capabilities()
        run = Run(lead_frames=can.lead_frames, reads_regions=bool(can.roi_sizes_px))
        commands = _Commands(sensor, run) if run.reads_regions else None
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s and (exposure := sensor.read(memory)) is not None:
            run.seqs.append(exposure.header.seq)
            run.stamps_ns.append(exposure.header.stamp_ns)
            run.streams.add(exposure.header.stream)
            if len(run.seqs) <= SETTLING:
                end_s = time.monotonic() + duration_s
            elif commands is not None:
                commands.after(exposure)
    run.summary = sensor.summary()
    return run


def rate(run: Run) -> Figures:
    """Rate asked for and measured by the stamps; raises `ContractBroken` for one that is not kept.

    A sensor that is asked for none tells only the measured one. The first frames do not count
    where there are enough others.
    """
    if len(run.seqs) < 2:
        raise ContractBroken(f"rate: expected at least two frames, got {len(run.seqs)}")
    first = SETTLING if len(run.seqs) > 2 * SETTLING else 0
    gaps_ns = np.diff(np.array(run.stamps_ns[first:], np.int64))
    if gaps_ns.min() <= 0:
        raise ContractBroken("stamps: expected each after the one before, got one that is not")
    measured_hz = len(gaps_ns) / (gaps_ns.sum() / 1e9)
    asked_hz = float(run.summary.get(RATE, {}).get("asked_hz", 0.0))
    figures = {
        "asked_hz": round(asked_hz, 3),
        "measured_hz": round(float(measured_hz), 3),
        "frames": len(gaps_ns) + 1,
        "longest_gap_ms": round(float(gaps_ns.max()) / 1e6, 1),
    }
    if measured_hz < LEAST_RATE * asked_hz:
        longest = f"with a gap of {figures['longest_gap_ms']:g} ms"
        raise ContractBroken(f"rate: expected {asked_hz:g} Hz, got {measured_hz:.2f} Hz {longest}")
    return figures


def effect(run: Run) -> Figures:
    """Frames from the one that a command was made from to the first that obeys it."""
    if not run.reads_regions:
        return {SKIPPED: "it reads no region"}
    if not run.effects:
        raise ContractBroken(
            f"commands: expected an effect within {run.lead_frames + PATIENCE} frames, got none in "
            f"{len(run.seqs)} frames"
        )
    if run.without_effect or run.wrong_windows:
        raise ContractBroken(
            f"commands: expected {len(run.effects) + run.without_effect} to take effect, got "
            f"{run.without_effect} that did not and {run.wrong_windows} with another window"
        )
    figures = {
        "told": run.lead_frames,
        "least": min(run.effects),
        "median": float(np.median(run.effects)),
        "most": max(run.effects),
        "commands": len(run.effects),
    }
    if min(run.effects) < run.lead_frames:
        raise ContractBroken(
            f"lead_frames: expected effects after at least {run.lead_frames}, got {figures}"
        )
    return figures


def accounts(run: Run) -> Figures:
    """Frames delivered, missing by their numbers, and accounted for by the sensor's figures."""
    if not run.seqs:
        raise ContractBroken("accounts: expected frames, got none")
    if len(run.streams) != 1:
        raise ContractBroken(f"stream: expected one, got {len(run.streams)}")
    told = dict(run.summary.get("frames", {}))
    left_out = (*NO_LOSSES, *(WITHIN if "skipped" in told else ()))
    accounted = sum(count for name, count in told.items() if name not in left_out)
    missing = run.seqs[-1] - run.seqs[0] + 1 - len(run.seqs)
    figures = {"delivered": len(run.seqs), "dropped": missing, "accounted": accounted}
    if told.get("exposed") != len(run.seqs):
        raise ContractBroken(
            f"accounts: expected {len(run.seqs)} exposed as were read, got {told.get('exposed')}"
        )
    if missing > accounted:
        raise ContractBroken(
            f"accounts: expected a reason for {missing} missing frames, got {accounted}: {told}"
        )
    return figures
