"""Hostile inputs at a unit's faces, beside who reads it: ``python -m fuzz.hostile --inputs 100000``.

What is nearly valid comes from other processes, from the unit's own computer, where no limit of requests
keeps it off; at consoles it is typed. Each answer is held against the contract; who polls, looks or asks
meanwhile must get what is right each time, nothing may be logged, and nothing be left behind.
"""

from __future__ import annotations

import argparse
import asyncio
import sys

from fuzz.hostile.runner import FACES, run


def main() -> int:
    """Attack each interface as often as is asked for; 1 when something was wrong."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.hostile", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="at each face")
    parser.add_argument("--face", choices=FACES, action="append", help="only this one")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    wrong = 0
    for face in options.face or FACES:
        tally = asyncio.run(run(face, options.inputs, options.seed))
        print(f"{face}:", *tally.lines(), sep="\n  ", flush=True)
        wrong += len(tally.wrong)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
