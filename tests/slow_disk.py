"""A recorder whose disk is slow."""

import time

from operators.record import Record
from pipeline.recording.mcap_file import Item
from pipeline.recording.recorder import Recorder

WRITE_S = 0.1  # for each message


class SlowRecorder(Recorder):
    """Needs `WRITE_S` for each message."""

    def _write(self, items: list[Item]) -> None:
        time.sleep(WRITE_S)
        super()._write(items)


class SlowRecord(Record):
    """Records to a slow disk."""

    recorder_type = SlowRecorder
