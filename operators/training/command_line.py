"""Options and error handling shared by the commands of trainings and their evaluations."""

import argparse
import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from pipeline.errors import FoveaError
from pipeline.extras import remedy

GOES_ON = "interrupted; repeat the command to resume"
_NO_MEMORY = re.compile(r"out of memory|can't allocate memory|not enough memory")
REFUSED, INTERRUPTED, STOPPED = 2, 128 + signal.SIGINT, 128 + signal.SIGTERM


def add_numbers(parser: argparse.ArgumentParser, settings: type[Any]) -> None:
    """An option for every number among the settings of a training."""
    for name, made in settings.__dataclass_fields__.items():
        if type(made.default) in (int, float):
            option = f"--{name.replace('_', '-')}"
            parser.add_argument(option, type=type(made.default), default=made.default)


def count(text: str) -> int:
    """A whole number from 1 on, for argparse."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


@contextmanager
def in_a_sentence(interrupted: str = "interrupted") -> Iterator[None]:
    """End the process with a sentence and a status on an expected error.

    SIGTERM is handled like an error, so that worker processes end, too. `interrupted` is the
    message after Ctrl-C.
    """
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(STOPPED))
    try:
        yield
    except FoveaError as error:
        _end(str(error), REFUSED)
    except ModuleNotFoundError as error:
        if not (why := remedy(error)):
            raise
        _end(why, REFUSED)
    except (MemoryError, RuntimeError) as error:  # torch raises the latter
        if isinstance(error, RuntimeError) and not _NO_MEMORY.search(str(error)):
            raise
        less = "; a smaller --batch needs less" if interrupted == GOES_ON else ""
        said = str(error).split("\n", 1)[0]  # torch adds where in its code it was
        _end(f"not enough memory{less}" + (f": {said}" if said else ""), REFUSED)
    except (FileExistsError, NotADirectoryError) as error:
        _end(f"{error.filename}: expected a folder, got a file", REFUSED)
    except OSError as error:  # a full disk, a file that is not ours
        _end(f"{error.filename}: {error.strerror}" if error.filename else str(error), REFUSED)
    except KeyboardInterrupt:
        # a second one ends it at once; it would end it with a traceback
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
        _end(interrupted, INTERRUPTED)
    finally:
        signal.signal(signal.SIGTERM, before)


def _end(sentence: str, status: int) -> NoReturn:
    print(f"fovea: {sentence}", file=sys.stderr)
    sys.exit(status)
