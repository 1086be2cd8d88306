"""Memory of the frame pool for the exposure in hand and, lent ahead, for the next one.

A read into it is in flight before the header of its frame has come: see `Receiver.payloads`.
"""

from collections.abc import Iterable, Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.usb.errors import LinkError
from drivers.usb.frame_header import Stream
from pipeline.contract import Loan
from pipeline.errors import PoolExhausted

Pixels = NDArray[np.generic]
Kind = tuple[Stream, tuple[int, ...], DTypeLike]  # of a frame: its stream, shape and type


class FrameMemory:
    """Memory of each stream, lent ahead where `ahead`; what was lost is used again."""

    def __init__(self, *, ahead: bool) -> None:
        self._ahead = ahead
        self._next: dict[Stream, Pixels] = {}
        self._spare: dict[Stream, list[Pixels]] = {stream: [] for stream in Stream}

    @property
    def ready(self) -> bool:
        """Whether some is lent for the next exposure."""
        return bool(self._next)

    def take(self, kinds: Iterable[Kind], loan: Loan) -> list[Pixels]:
        """Return memory for each frame of an exposure, that which was lent ahead first.

        Raises `PoolExhausted` as the loan does, and `LinkError` for a frame that differs from the
        one before, whose memory may be written already.
        """
        taken: list[tuple[Stream, Pixels]] = []
        try:
            for stream, shape, dtype in kinds:
                lent = self._next.pop(stream, None)
                if lent is not None and (lent.shape != shape or lent.dtype != dtype):
                    taken.append((stream, lent))
                    got = f"{shape} of {np.dtype(dtype)}"
                    raise LinkError(f"{stream.name.lower()}: expected {lent.shape}, got {got}")
                if lent is None:
                    lent = self._lent(stream, shape, dtype, loan)
                taken.append((stream, lent))
        except PoolExhausted:
            self._next |= dict(taken)
            raise
        except LinkError:  # which ends all reads
            for stream, memory in taken:
                self._spare[stream].append(memory)
            raise
        return [memory for _, memory in taken]

    def lend(self, kinds: Iterable[Kind], loan: Loan) -> Mapping[Stream, Pixels] | None:
        """Return memory for the next frames as far as there is some; None: none is lent ahead."""
        if not self._ahead:
            return None
        lent = {}
        for stream, shape, dtype in kinds:
            with suppress(PoolExhausted):  # it is asked for again when the frame has come
                lent[stream] = self._lent(stream, shape, dtype, loan)
        self._next |= lent
        return lent

    def return_lost(self, streams: Iterable[Stream], lost: Iterable[Pixels]) -> None:
        """Take back memory of an exposure that was lost."""
        for stream, memory in zip(streams, lost, strict=True) if self._ahead else ():
            self._spare[stream].append(memory)

    def _lent(self, stream: Stream, shape: tuple[int, ...], dtype: DTypeLike, loan: Loan) -> Pixels:
        fitting = [m for m in self._spare[stream] if m.shape == shape and m.dtype == dtype]
        self._spare[stream] = fitting[1:]
        if fitting:
            return fitting[0]
        return loan(stream.name.lower(), shape, dtype, ahead=self._ahead)
