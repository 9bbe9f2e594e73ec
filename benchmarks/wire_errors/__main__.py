"""``python -m benchmarks.wire_errors`` (``make bench-wires``): errors on every wire, and which are found."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from altd.errors import BadInputError
from benchmarks.wire_errors import tally_page
from benchmarks.wire_errors.runner import run


def main(arguments: list[str] | None = None) -> int:
    """Run, print the table; 1 when an error passed for a good message."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.wire_errors", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="of each error on each wire")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the page there")
    options = parser.parse_args(arguments)
    tallies = run(options.count, options.seed, _show)
    _show("")
    print("\n".join(tally_page.text(tallies)))
    if options.page is not None:
        command = f"python -m benchmarks.wire_errors --count {options.count} --seed {options.seed}"
        try:
            tally_page.write_page(options.page, tallies, command)
        except BadInputError as error:
            print(f"wire_errors: {error}", file=sys.stderr)
            return 2
    return 1 if tally_page.passed(tallies) else 0


def _show(what: str) -> None:
    """One line on standard error while it is a terminal; silence otherwise."""
    if sys.stderr.isatty():
        print(f"\r\033[K{what}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
