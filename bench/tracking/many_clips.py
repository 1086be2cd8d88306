"""Clips of `--many`, each scored by a worker process and written when it is done: clips -> rows."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import cv2

from bench.tracking.cases import Protocol
from bench.tracking.classes import planned
from bench.tracking.clip import ClipName
from bench.tracking.job import warnings_into
from bench.tracking.key import CODE, contents, unit_files
from bench.tracking.many import Row, many, opened, policies, wanted_of
from bench.tracking.options import Options
from bench.tracking.pooled import write_units
from bench.tracking.store import forget_damaged, units
from operators.training.identity import of_code
from pipeline.whole_file import write_whole

SCORING = (
    *("bench.tracking.many", "bench.tracking.identities", "operators.identity"),
    "operators.policy.greedy",  # of the oracle's window
)


def scored_clips(options: Options, clips: Sequence[ClipName], protocol: Protocol) -> list[Row]:
    """Return the rows of all clips: finished ones from the folder, the others after scoring them.

    Raises `SettingsError` for plans that come too late, before any clip is scored.
    """
    with opened(options, protocol):
        pass  # what cannot be opened is refused here, once
    key = key_of_many(options, protocol)
    paths = {clip: unit_files(options.folder, clip, protocol.frames, [key])[0] for clip in clips}
    forget_damaged(paths.values())
    left = [
        partial(score, clip, options, protocol, path)
        for clip, path in paths.items()
        if not path.exists()
    ]
    write_units(left, list(paths.values()), options.folder, jobs=options.jobs)
    return [row for path in paths.values() for row in units(path)]


def score(
    name: ClipName, options: Options, protocol: Protocol, path: Path, warnings_file: Path
) -> None:
    """Score a clip and write its rows."""
    cv2.setNumThreads(1)
    with warnings_into(warnings_file, str(name)):
        write_whole(path, json.dumps(many(name, options, protocol)))


def key_of_many(options: Options, protocol: Protocol) -> str:
    """Return what determines the rows of a clip: options, code, settings and networks."""
    wanted = wanted_of(options)
    plain = [wanted, [str(budget) for budget in options.budgets], options.delay, options.missed]
    graphs = {
        name: contents(plan, [node.name for node in plan.nodes])
        for name, policy in (("", ""), *policies(wanted, options))
        for plan in (planned(Path(protocol.graph), options.changes, "", policy),)
    }
    return json.dumps(
        ["many", plain, protocol.frames, of_code(*CODE, *SCORING), graphs], sort_keys=True
    )
