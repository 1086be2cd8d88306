"""Sensors that break their contract in one way each."""

import os
import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.sensor import Capabilities, Exposure
from drivers.simulated import SimulatedSensor
from pipeline.contract import Loan
from pipeline.errors import DriverError, PoolExhausted
from pipeline.messages import RoiSchedule


class SameNumber(SimulatedSensor):
    """Every exposure has number 0."""

    def read(self, loan: Loan) -> Exposure | None:
        found = super().read(loan)
        if found is None:
            return None
        header = replace(found.header, seq=0)
        context, roi = replace(found.context, header=header), replace(found.roi, header=header)
        return Exposure(header=header, context=context, roi=roi)


class SamePicture(SimulatedSensor):
    """The context never changes."""

    def read(self, loan: Loan) -> Exposure | None:
        found = super().read(loan)
        if found is not None:
            found.context.pixels[...] = 7
        return found


class SameStream(SimulatedSensor):
    """A new opening continues the old stream."""

    def open(self, *, realtime: bool) -> None:
        super().open(realtime=realtime)
        self._stream = "always"


class Disobedient(SimulatedSensor):
    """Commands are taken and forgotten."""

    def set_rois(self, schedule: RoiSchedule) -> None: ...


class Stretched(SimulatedSensor):
    """The ROI says that it shows less than it does."""

    def read(self, loan: Loan) -> Exposure | None:
        found = super().read(loan)
        if found is None:
            return None
        left, top, right, bottom = found.roi.window
        return replace(found, roi=replace(found.roi, window=(left, top, right - 2, bottom)))


class Uncounted(SimulatedSensor):
    """Late commands are not counted."""

    def summary(self) -> Mapping[str, Any]:
        return {**super().summary(), "commands": {"accepted": 1, "late": 0, "foreign": 1}}


class Hoarding(SimulatedSensor):
    """An exposure for which there is no memory is delivered with the next one's number."""

    def read(self, loan: Loan) -> Exposure | None:
        try:
            return super().read(loan)
        except PoolExhausted:
            return super().read(lambda _output, shape, dtype: np.empty(shape, dtype))


class Copying(SimulatedSensor):
    """Pictures lie elsewhere than in the memory that was lent."""

    def read(self, loan: Loan) -> Exposure | None:
        found = super().read(loan)
        if found is None:
            return None
        return replace(found, roi=replace(found.roi, pixels=found.roi.pixels.copy()))


class Restless(SimulatedSensor):
    """It goes on after it was stopped."""

    def stop(self) -> None: ...


class Eager(SimulatedSensor):
    """It says that commands take effect later than they do."""

    def capabilities(self) -> Capabilities:
        return replace(super().capabilities(), lead_frames=3)


class Silent(SimulatedSensor):
    """It never delivers anything."""

    def read(self, loan: Loan) -> Exposure | None:
        threading.Event().wait()
        return None


class Crashing(SimulatedSensor):
    """Its library ends the process."""

    def read(self, loan: Loan) -> Exposure | None:
        os.kill(os.getpid(), signal.SIGSEGV)
        return None


class Closed(SimulatedSensor):
    """It cannot be opened."""

    def open(self, *, realtime: bool) -> None:
        raise DriverError("closed: expected a key, got none")


class Buggy(SimulatedSensor):
    """It has a mistake."""

    def read(self, loan: Loan) -> Exposure | None:
        raise KeyError("exposure")
