"""``python -m tools.defects``: run the tests on copies of altd with one defect at a time.

The defects are those of the catalogue and 48 drawn ones. The unit tests nearest to the module run first, then
those of its room, then all of ``make test``, until one fails that passes without the defect.
"""

import argparse
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from altd.process.endings import run_to_end
from tools.defects.catalogue import DEFECTS, EXPLAINED
from tools.defects.copies import Copies
from tools.defects.defect import Defect
from tools.defects.draw import drawn

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Print the test that caught each defect; return 1 if one was not caught and is not explained."""
    parser = argparse.ArgumentParser(prog="python -m tools.defects", description=__doc__)
    parser.add_argument("rooms", nargs="*", help="only defects of these rooms; without: all")
    parser.add_argument("--draw", type=int, metavar="N", help="only N drawn defects, none of the catalogue")
    parser.add_argument("--seed", type=int, default=1, help="another seed draws other defects")
    parser.add_argument("--modules", type=int, default=0, metavar="N", help="draw in N random modules")
    parser.add_argument(
        "--suite", choices=("room", "unit", "all"), default="unit", help="last tests that run"
    )
    parser.add_argument("--list", action="store_true", help="print the defects, run nothing")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), metavar="N")
    options = parser.parse_args()
    catalogue = DEFECTS if options.draw is None else ()
    defects = [*catalogue, *drawn(ROOT, options.draw or 48, options.seed, options.modules)]
    defects = [defect for defect in defects if not options.rooms or defect.room in options.rooms]
    if options.list:
        print(*(defect.what for defect in defects), sep="\n")
        return 0
    with tempfile.TemporaryDirectory(prefix="altd-defects-", dir=ROOT.parent) as folder:
        copies = Copies(
            ROOT, Path(folder), min(options.workers, len(defects))
        )  # the tests find ../shared there
        return report(defects, copies, options.suite)


def report(defects: list[Defect], copies: Copies, suite: str = "unit") -> int:
    """Run the tests on each defect; return 1 if one was not caught and is not explained."""
    caught, explained = 0, 0
    pool = ThreadPoolExecutor(copies.number)
    try:
        for defect, found in zip(
            defects, pool.map(lambda of: copies.caught_by(of, suite), defects), strict=True
        ):
            why = EXPLAINED.get(defect.what, "")
            caught += bool(found)
            explained += bool(why and not found)
            print(f"{defect.what}\n    {found or (why and f'explained: {why}') or 'NOT CAUGHT'}", flush=True)
    finally:
        copies.end()
        pool.shutdown(cancel_futures=True)
    missed = len(defects) - caught - explained
    print(f"{caught} of {len(defects)} defects caught, {explained} explained, {missed} NOT CAUGHT")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "tools.defects"))
