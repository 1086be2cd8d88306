"""A training's log.csv: a header, then step, seconds and figures every `EVERY` steps."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from pipeline.whole_file import write_whole

EVERY = 20


def note(log: Path, step: int, elapsed_s: float, figures: Mapping[str, float]) -> None:
    """Add a line; the first one comes with the header."""
    lines = [",".join([f"{step},{elapsed_s:.0f}", *(f"{v:.4f}" for v in figures.values())])]
    if not log.exists():
        lines.insert(0, ",".join(["step", "elapsed_s", *figures]))
    with log.open("a") as file:
        file.write("".join(f"{line}\n" for line in lines))


def shorten(log: Path, step: int) -> None:
    """Remove log lines after the checkpoint that a training resumes from."""
    if not log.exists():
        return
    header, *lines = log.read_text().split("\n")[:-1] or [""]  # what follows the last end is torn
    kept, last = list[str](), -1
    commas = Counter(line.count(",") for line in lines).most_common(1)
    for line in lines:
        number = line.partition(",")[0]
        # a line with other commas was torn by a full disk or a power failure
        if number.isdigit() and line.count(",") == commas[0][0] and last < int(number) <= step:
            kept.append(line)
            last = int(number)
    if kept:
        write_whole(log, "".join(f"{line}\n" for line in [header, *kept]))
    else:  # its header may be torn too
        log.unlink()
