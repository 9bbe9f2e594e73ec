"""Hostile inputs at a unit's interfaces, beside a reader: ``python -m fuzz.hostile --inputs 100000``.

Nearly valid inputs come from other processes on the unit's own computer, where no limit of requests holds
them off; at consoles they are typed. Each answer is checked against the contract; a client that polls, looks
or asks meanwhile must get the right answer each time, nothing may be logged, and nothing be left behind.
"""

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
