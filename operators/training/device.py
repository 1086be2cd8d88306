"""Devices of trainings: a device's name -> the device, its precision, and transfer of tensors."""

import torch
from torch import Tensor

from operators.training.ranges import known_device
from pipeline.errors import SettingsError

# what torch calls the instructions of processors, x86 and ARM
BFLOAT16 = {"avx512_bf16", "amx_bf16", "bf16", "sve_bf16"}


def device_of(name: str) -> torch.device:
    """A device that is there; `auto` is CUDA where torch has it, else the processor.

    Raises `SettingsError` for a name of none, and for one that torch does not see.

    >>> device_of("cpu")
    device(type='cpu')
    """
    known_device(name)
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    device = torch.device(name)
    seen = torch.cuda.device_count()
    if device.type == "cuda" and (device.index or 0) >= seen:
        raise SettingsError(f"device: no CUDA device {device.index or 0} here, torch sees {seen}")
    if device.type == "mps" and not torch.backends.mps.is_available():
        raise SettingsError("device: no MPS device here")
    return device


def mixed_precision(device: torch.device) -> torch.autocast:
    """Compute in bfloat16, while this is entered, where the device has instructions for it.

    Others, also MPS, compute in single precision. A processor without such instructions imitates
    them: a step of the detector's training then takes nine times as long.
    """
    return torch.autocast(device.type, torch.bfloat16, enabled=_has_bfloat16(device))


def _has_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if device.type != "cpu":
        return False
    if (told := getattr(torch.cpu, "get_capabilities", None)) is None:  # before torch 2.11
        return bool(torch.cpu._is_avx512_bf16_supported())
    return not BFLOAT16.isdisjoint(name for name, has in told().items() if has)


def moved(values: Tensor, device: torch.device) -> Tensor:
    """The same on a device; nothing is copied when it is there already."""
    if device.type == "cuda" and values.device.type == "cpu":
        # from pinned memory the copy runs beside what the processor does next
        return values.pin_memory().to(device, non_blocking=True)
    return values.to(device)


def has_room(device: torch.device, size_bytes: int) -> bool:
    """Whether a GPU holds that much and keeps as much again for computing."""
    if device.type != "cuda":
        return False
    free, _ = torch.cuda.mem_get_info(device)
    unused = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return bool(2 * size_bytes <= free + unused)
