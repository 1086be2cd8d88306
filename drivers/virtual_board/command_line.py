"""What the programs that attach a virtual board are told: options in, settings out."""

from collections.abc import Callable
from typing import Any

import click

from drivers.virtual_board.backend import VirtualBoardSettings
from pipeline.errors import SettingsError

FAULT = "KIND:EXPOSURE[:STREAM[:SECONDS]]"


def board_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a board; the command gets them as keywords for `board_settings`."""
    for option in reversed((
        click.option("--profile", default="ideal", show_default=True, help="What it can do."),
        click.option("--scene", default="soccer", show_default=True, help="Scene or import path."),
        click.option(
            "--size", nargs=2, type=int, default=(0, 0), metavar="WIDTH HEIGHT",
            help="Of the sensor.",
        ),
        click.option("--frames", default=0, help="Exposures until the end; 0: endless."),
        click.option("--seed", default=0, help="Of scene and noise."),
        click.option("--fault", "faults", multiple=True, metavar=FAULT, help="What goes wrong."),
    )):  # fmt: skip
        command = option(command)
    return command


def board_settings(
    *, profile: str, scene: str, size: tuple[int, int], frames: int, seed: int,
    faults: tuple[str, ...],
) -> VirtualBoardSettings:  # fmt: skip
    """Return the settings; raises `SettingsError`."""
    return VirtualBoardSettings(
        profile=profile, scene=scene, size_px=size, frames=frames, seed=seed,
        faults=tuple(map(_fault, faults)),
    )  # fmt: skip


def _fault(text: str) -> dict[str, Any]:
    kind, *rest = text.split(":")
    try:
        found: dict[str, Any] = {"kind": kind, "exposure": int(rest[0])}
        if len(rest) > 1:
            found["stream"] = rest[1]
        if len(rest) > 2:
            (found["seconds"],) = map(float, rest[2:])
    except (IndexError, ValueError):
        raise SettingsError(f"--fault: expected {FAULT}, got {text}") from None
    return found
