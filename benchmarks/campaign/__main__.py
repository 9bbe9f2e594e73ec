"""``python -m benchmarks.campaign`` (``make campaign``): disturbed measurements, judged against the truth."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from altd.errors import BadInputError
from altd.process.endings import run_to_end
from benchmarks.campaign import tally_table
from benchmarks.campaign.catalogue import WAYS, chosen
from benchmarks.campaign.episode import WINDOW
from benchmarks.campaign.good import lines as good_lines
from benchmarks.campaign.good import run_good
from benchmarks.campaign.runner import Effort, Plan, run
from benchmarks.campaign.tally_table import RunDescription, write_page
from benchmarks.campaign.units import NAMES, RECORDED, RECORDINGS, cache_folder
from benchmarks.campaign.ways.spots import BEAMS, photographed_beam
from benchmarks.progress import show


def main(arguments: list[str] | None = None) -> int:
    """Run and print the table; return 1 if a wrong measurement was marked valid although it is detectable."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["good"]:
        return _good(arguments[1:])
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.campaign",
        description=__doc__,
        epilog="python -m benchmarks.campaign good --help: hours of good measuring",
    )
    parser.add_argument("--seconds", type=float, help="end after so long (default 180 unless --measurements)")
    parser.add_argument("--measurements", type=int, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ways", default="", metavar="NAME,...", help="names or kinds; --list shows them")
    parser.add_argument("--units", default="", metavar="NAME,...", help=", ".join(NAMES))
    parser.add_argument(
        "--pairs", type=float, default=0.2, help="share disturbed in two ways at once (default 0.2)"
    )
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the page there")
    parser.add_argument("--worst", action="store_true", help="show the worst of each way")
    parser.add_argument("--list", action="store_true", help="show the ways and end")
    options = parser.parse_args(arguments)
    if options.list:
        for way in WAYS.values():
            print(f"{way.kind:<9} {way.name:<22} {(way.make.__doc__ or '').strip()}")
        return 0
    return _campaign(options)


def _campaign(options: argparse.Namespace) -> int:
    units = tuple(options.units.split(",")) if options.units else NAMES
    for unit in units:
        if unit not in NAMES:
            raise BadInputError("--units", f"unknown unit {unit!r}; known are {', '.join(NAMES)}")
    if not RECORDINGS.is_dir():
        if options.units and RECORDED in units:
            raise BadInputError("--units", f"{RECORDED} needs the recordings in {RECORDINGS}")
        units = tuple(unit for unit in units if unit != RECORDED)
    plan = Plan(tuple(way.name for way in chosen(options.ways)), units, options.seed, options.pairs)
    for left_out, place in ((RECORDED, RECORDINGS), (photographed_beam.__name__, BEAMS)):
        if not place.is_dir():
            print(f"campaign: without {left_out}: {place} is not there", file=sys.stderr)
    seconds = options.seconds or (None if options.measurements else 180.0)
    tallies, took_s = run(plan, Effort(seconds, options.measurements, options.processes), _show)
    show("")
    print("\n".join(tally_table.text(tallies)))
    if options.worst:
        print("\n".join(("", *tally_table.worst(tallies))))
    if options.page is not None:
        command = "python -m benchmarks.campaign " + " ".join(_given(options))
        run_of_page = RunDescription(command, plan.seed, ", ".join(plan.units), took_s, WINDOW)
        write_page(options.page, tallies, run_of_page)
    print(f"{took_s:.0f} s, seed {plan.seed}, {options.processes} processes, units {', '.join(plan.units)}")
    return 1 if tally_table.wrong_count(tallies) else 0


def _given(options: argparse.Namespace) -> list[str]:
    """Command that repeats the run, with its original arguments."""
    given = {
        name: getattr(options, name) for name in ("seconds", "measurements", "ways", "units", "pairs", "seed")
    }
    return [f"--{name} {value}" for name, value in given.items() if value not in (None, "")]


def _good(arguments: list[str]) -> int:
    """Hours of undisturbed measuring; exit status 1 if a measurement was wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign good", description=_good.__doc__)
    parser.add_argument("--hours", type=int, default=24)
    parser.add_argument("--step-s", type=float, default=300.0, help="a burst of exposures this often")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    sums = run_good(
        options.hours, options.step_s, options.seed, options.processes, cache_folder(), _show_share
    )
    print("\n".join(good_lines(sums, options.hours, options.step_s)))
    return 1 if any(count.wrong for count in sums.values()) else 0


def _show_share(done: int, planned: int) -> None:
    show(f"{done} of {planned} hours" if done < planned else "")


def _show(made: int, passed_s: float) -> None:
    show(f"{made} measurements, {made / max(passed_s, 1e-9):.0f} a second")


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "benchmarks.campaign"))
