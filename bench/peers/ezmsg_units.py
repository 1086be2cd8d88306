"""ezmsg: two units in two processes, the picture inside the message, read without a copy."""

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from typing import Any

import ezmsg.core as ez
import numpy as np

from bench.peers.ruler import RING, Bytes, Job, Reader, Writer, contest


@dataclass
class Picture:
    """What travels."""

    seq: int
    payload: Bytes


class JobSettings(ez.Settings):  # type: ignore[misc]
    """What each unit must know."""

    job: Job


class Produce(ez.Unit):  # type: ignore[misc]
    """Fills own memory; the framework moves it into shared memory."""

    SETTINGS = JobSettings
    OUT = ez.OutputStream(Picture, num_buffers=RING)

    @ez.publisher(OUT)  # type: ignore[untyped-decorator]
    async def run(self) -> AsyncGenerator[Any, None]:
        """All messages, then the end of both units."""
        job = self.SETTINGS.job
        writer, payload = Writer(job), np.zeros(job.size_bytes, np.uint8)
        await asyncio.sleep(0.5)
        for seq in range(job.total):
            await asyncio.sleep(writer.rest_s(seq))
            writer.write(payload, seq)
            yield self.OUT, Picture(seq, payload)
        await asyncio.sleep(0.5)
        writer.save()
        raise ez.NormalTermination


class Consume(ez.Unit):  # type: ignore[misc]
    """Reads in place."""

    SETTINGS = JobSettings
    IN = ez.InputStream(Picture)

    async def initialize(self) -> None:
        """In the process that reads."""
        self.reader = Reader(self.SETTINGS.job)

    @ez.subscriber(IN, zero_copy=True)  # type: ignore[untyped-decorator]
    async def on_picture(self, picture: Picture) -> None:
        """One message."""
        self.reader.read(picture.payload, picture.seq)

    async def shutdown(self) -> None:
        """Leave the figures."""
        self.reader.save()


class Pair(ez.Collection):  # type: ignore[misc]
    """The graph."""

    SETTINGS = JobSettings
    PRODUCE = Produce()
    CONSUME = Consume()

    def configure(self) -> None:
        """Hand the job on."""
        self.PRODUCE.apply_settings(self.SETTINGS)
        self.CONSUME.apply_settings(self.SETTINGS)

    def network(self) -> tuple[tuple[Any, Any], ...]:
        """One edge."""
        return ((self.PRODUCE.OUT, self.CONSUME.IN),)

    def process_components(self) -> tuple[Any, ...]:
        """A process each."""
        return (self.PRODUCE, self.CONSUME)


def launch(job: Job) -> None:
    """ezmsg starts its processes itself."""
    ez.run(PAIR=Pair(JobSettings(job=job)))


if __name__ == "__main__":
    contest("ezmsg", ("ezmsg", "numpy"), launch)
