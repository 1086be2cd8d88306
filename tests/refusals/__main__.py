"""Compare refusals with those of another commit: `python -m tests.refusals --against COMMIT`.

With `--record` the answers of that commit become those that the test expects; a case that it does
not refuse needs a reason (`new`), and is recorded as this source tree answers it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.refusals.catalogue import RECORDED, ROOT, cases, lost, play, recorded


def main() -> None:
    """Play all cases with both, print what was lost, and exit with 1 if anything was."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", metavar="COMMIT", default="", help="default: what is recorded")
    parser.add_argument("--record", action="store_true", help="write the answers of the commit")
    given = parser.parse_args()
    found = cases()
    now = play(found)
    was = recorded() if not given.against else {}
    if given.against:
        with source_of(given.against) as root:
            former = play(found, root, former=True)
        for case in found:
            said = now[case.case] if case.new else former[case.case]
            was[case.case] = {"exit": said.status, "said": said.sentence}
            if not case.new and not said.is_one:
                print(f"{case.case}: at {given.against}: {said.status} {said.whole!r}")
    if given.record:
        RECORDED.write_text(json.dumps(was, indent=1, ensure_ascii=False) + "\n")
    worse = 0
    for case in found:
        if gone := list(lost(case, was[case.case], now[case.case])):
            worse += 1
            print(f"{case.case}: {'; '.join(gone)}")
            print(f"  was: {was[case.case]['said']}\n  now: {now[case.case].sentence}")
    slow = sorted(now, key=lambda name: -now[name].seconds)[:12]
    print("slowest:", *(f"{name} {now[name].seconds:.1f} s" for name in slow), sep="\n  ")
    print(f"{len(found)} cases, {worse} differences that nothing explains")
    sys.exit(worse > 0)


@contextmanager
def source_of(commit: str) -> Iterator[Path]:
    """Yield the source tree of a commit in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "source"
        root.mkdir()
        packed = subprocess.run(
            ["git", "archive", commit], cwd=ROOT, stdout=subprocess.PIPE, check=True
        )
        subprocess.run(["tar", "-x", "-C", str(root)], input=packed.stdout, check=True)
        yield root


if __name__ == "__main__":
    main()
