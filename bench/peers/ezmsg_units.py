"""ezmsg: two units in two processes, its shared memory, zero-copy on the receiving side."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass

import ezmsg.core as ez  # type: ignore[import-not-found, unused-ignore]
import numpy as np

from bench.peers.ruler import Bytes, Meter, Task, Writer, contestant


@dataclass
class Picture:
    """The message."""

    pixels: Bytes


class SideSettings(ez.Settings):  # type: ignore[misc, unused-ignore]
    """The settings of both sides."""

    task: Task


class Sender(ez.Unit):  # type: ignore[misc, unused-ignore]
    """The sending side."""

    SETTINGS = SideSettings
    OUT = ez.OutputStream(Picture, num_buffers=32)

    @ez.publisher(OUT)  # type: ignore[untyped-decorator, unused-ignore]
    async def send(self) -> AsyncIterator[tuple[object, Picture]]:
        """Send at the rate, without blocking the loop that carries acknowledgements."""
        task = self.SETTINGS.task
        writer = Writer(task)
        pixels = np.zeros(task.nbytes, np.uint8)
        for number in range(task.total):
            await asyncio.sleep(writer.due_in_s(number))
            writer.begin(number)
            writer.write(pixels, number)
            yield self.OUT, Picture(pixels)
        writer.save()
        while not (task.folder / "receiver.json").exists():
            await asyncio.sleep(0.02)
        raise ez.NormalTermination


class Receiver(ez.Unit):  # type: ignore[misc, unused-ignore]
    """The receiving side."""

    SETTINGS = SideSettings
    IN = ez.InputStream(Picture)

    async def initialize(self) -> None:
        """Make the meter in the receiver's own process."""
        self.meter = Meter(self.SETTINGS.task)

    @ez.subscriber(IN, zero_copy=True)  # type: ignore[untyped-decorator, unused-ignore]
    async def on_picture(self, picture: Picture) -> None:
        """Read one picture."""
        self.meter.take(picture.pixels)

    @ez.task  # type: ignore[untyped-decorator, unused-ignore]
    async def watch(self) -> None:
        """Begin when the units are connected; report when all messages have arrived."""
        await asyncio.sleep(0.5)
        self.meter.ready()
        while not self.meter.finished:
            await asyncio.sleep(0.02)
        self.meter.save()


class Pair(ez.Collection):  # type: ignore[misc, unused-ignore]
    """Both units, connected, in two processes."""

    SETTINGS = SideSettings
    SENDER = Sender()
    RECEIVER = Receiver()

    def configure(self) -> None:
        """Pass the task to both units."""
        self.SENDER.apply_settings(self.SETTINGS)
        self.RECEIVER.apply_settings(self.SETTINGS)

    def network(self) -> tuple[tuple[object, object], ...]:
        """Return the only edge."""
        return ((self.SENDER.OUT, self.RECEIVER.IN),)

    def process_components(self) -> tuple[object, ...]:
        """Return the units that have processes of their own."""
        return (self.SENDER, self.RECEIVER)


def launch(task: Task) -> None:
    """Run both sides."""
    ez.run(PAIR=Pair(SideSettings(task)))


if __name__ == "__main__":
    contestant("ezmsg_units", "ezmsg", launch)
