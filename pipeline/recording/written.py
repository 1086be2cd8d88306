"""Count what the files of a recording hold: files -> messages by output, losses, and faults.

A file that was written to its end has its counts in its index. Of any other the whole chunks are
read: its recorder was killed, or could not write.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import RunError
from pipeline.recording.mcap_file import Contents, McapChunks, contents
from pipeline.recording.reader import End, end_of
from pipeline.recording.recorder import total
from pipeline.recording.records import ENCODING, output_of

NS = 1e9
Figures = dict[str, dict[str, int]]  # counts by output, as a recorder has them


@dataclass(frozen=True)
class Counted:
    """What the files of a recording hold."""

    outputs: Figures  # the messages that were recorded in all files, the losses of all recorders
    faults: dict[str, str]  # a sentence for each file that was not written to its end


def counted(files: Sequence[str], told_files: Sequence[str], told: Figures) -> Counted:
    """Return what these files hold, in the order in which they were begun.

    A recorder that is restarted counts anew. `told`: what one of them answered when it was asked,
    and with which files; it may have counted more since.
    """
    read = [(file, *_read(Path(file))) for file in files]
    recorders: list[Figures] = [] if files else [told]
    asked, begins = -1, True
    for file, _held, end in read:
        if begins or file in told_files[:1] or (end is not None and end.file == 1):
            recorders.append({})
        if file in told_files[:1]:
            asked = len(recorders) - 1
        if end is not None:
            recorders[-1] = end.accounts
        begins = end is None  # its recorder did not go on
    if asked >= 0:  # of a ring the file can be older than the answer
        recorders[asked] = max(
            recorders[asked], told, key=lambda figures: sum(total(figures).values())
        )
    return Counted(_together(recorders, [held for _, held, _ in read]), dict(_faults(read)))


def _read(file: Path) -> tuple[Contents, End | None]:
    """Return what a file holds, and what its recorder wrote at its end; None: it did not."""
    end, held = end_of(file), contents(file)
    if end is not None and held is not None:
        return held, end
    counts, times_ns = Counter[tuple[str, str]](), list[int]()
    try:
        for _place, items in McapChunks(file).scan():
            counts.update((item.topic.name, item.topic.encoding) for item in items)
            logged_ns = [item.log_ns for item in items] + times_ns
            times_ns = [min(logged_ns), max(logged_ns)] if logged_ns else []
    except (RunError, OSError):
        pass  # it has not even a beginning, or is gone
    return Contents(counts, *(times_ns or (0, 0))), None


def _together(recorders: Sequence[Figures], held: Sequence[Contents]) -> Figures:
    found: dict[str, Counter[str]] = {}
    for figures in recorders:
        for output, counts in figures.items():
            found.setdefault(output, Counter()).update(counts)
    if held:
        recorded = Counter[str]()
        for one in held:
            for (topic, encoding), count in one.counts.items():
                recorded[output_of(topic)] += count * (encoding == ENCODING)
        for output in found.keys() | +recorded:
            found.setdefault(output, Counter())["recorded"] = recorded[output]
    return {output: dict(counts) for output, counts in found.items()}


def _faults(read: Sequence[tuple[str, Contents, End | None]]) -> Iterator[tuple[str, str]]:
    """Yield each file without its end, and a sentence about it."""
    for index, (file, held, end) in enumerate(read):
        if end is None:
            gap = ""
            if index + 1 < len(read):
                after, following, _ = read[index + 1]
                lost_s = max(0, following.first_ns - held.last_ns) / NS
                gap = f"; then the recorder was restarted: {lost_s:.1f} s"
                gap += f" before {Path(after).name} are missing"
            yield file, f"{file}: not written to its end; its whole chunks can be read{gap}"
