"""``python -m benchmarks.campaign`` (``make campaign``): disturbed measurements, judged against the truth."""

import argparse
import sys

from altd.errors import BadInputError
from benchmarks.campaign import tally_table
from benchmarks.campaign.episode import WINDOW
from benchmarks.campaign.good import lines as good_lines
from benchmarks.campaign.good import run_good
from benchmarks.campaign.runner import Effort, Plan, run
from benchmarks.campaign.units import NAMES, RECORDED, RECORDINGS, cache_folder
from benchmarks.campaign.ways import WAYS, chosen, listed
from benchmarks.campaign.ways.spots import BEAMS, photographed_beam
from benchmarks.harness import Parser, end, show, write_page


def main(arguments: list[str] | None = None) -> int:
    """Run and print the table; return 1 if a wrong measurement was marked valid although it is detectable."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["good"]:
        return _good(arguments[1:])
    parser = Parser(
        "benchmarks.campaign", __doc__, "python -m benchmarks.campaign good --help: hours of good measuring"
    )
    parser.number("--seconds", None, "end after so long (default 180 unless --measurements)")
    parser.count("--measurements", None, "end after so many")
    parser.seed()
    parser.add_argument("--ways", default="", metavar="NAME,...", help="names or kinds; --list shows them")
    parser.names("--units", NAMES, ", ".join(NAMES))
    parser.number("--pairs", 0.2, "share disturbed in two ways at once", "SHARE", (0.0, 1.0))
    parser.count("--processes", 2, "that measure")
    parser.page()
    parser.add_argument("--worst", action="store_true", help="show the worst of each way")
    parser.add_argument("--list", action="store_true", help="show the ways and end")
    options = parser.parse_args(arguments)
    if options.list:
        print(listed(WAYS))
        return 0
    plan = _plan(options)
    seconds = options.seconds or (None if options.measurements else 180.0)
    tallies, took_s = run(plan, Effort(seconds, options.measurements, options.processes), _show)
    show("")
    print("\n".join(tally_table.text(tallies)))
    if options.worst:
        print("\n".join(("", *tally_table.worst(tallies))))
    units = ", ".join(plan.units)
    if options.page is not None:
        told = f"`{_command(options)}` ({took_s:.0f} s; seed {plan.seed}; units {units})"
        write_page(options.page, tally_table.page(tallies, told, WINDOW))
    print(f"{took_s:.0f} s, seed {plan.seed}, {options.processes} processes, units {units}")
    return 1 if tally_table.wrong_count(tallies) else 0


def _plan(options: argparse.Namespace) -> Plan:
    """Selection of ways and units, without those that lack photographs or recordings."""
    units = options.units or NAMES
    if photographed_beam.__name__ in options.ways.split(",") and not BEAMS.is_dir():
        raise BadInputError("--ways", f"{photographed_beam.__name__} needs the photographs in {BEAMS}")
    if options.units and RECORDED in units and not RECORDINGS.is_dir():
        raise BadInputError("--units", f"{RECORDED} needs the recordings in {RECORDINGS}")
    ways = chosen(options.ways, WAYS, "--ways", "way")
    for left_out, place in ((RECORDED, RECORDINGS), (photographed_beam.__name__, BEAMS)):
        if not place.is_dir():
            print(f"campaign: without {left_out}: {place} is not there", file=sys.stderr)
    units = tuple(unit for unit in units if unit != RECORDED or RECORDINGS.is_dir())
    return Plan(tuple(way.name for way in ways), units, options.seed, options.pairs)


def _command(options: argparse.Namespace) -> str:
    """Command that repeats the run, with its original arguments."""
    names = ("seconds", "measurements", "ways", "units", "pairs", "seed")
    given = {name: getattr(options, name) for name in names} | {"units": ",".join(options.units or ())}
    words = [f"--{name} {value}" for name, value in given.items() if value not in (None, "")]
    return " ".join(["python -m benchmarks.campaign", *words])


def _good(arguments: list[str]) -> int:
    """Hours of undisturbed measuring; exit status 1 if a measurement was wrong."""
    parser = Parser("benchmarks.campaign good", _good.__doc__)
    parser.count("--hours", 24, "of each unit")
    parser.number("--step-s", 300.0, "a burst of exposures this often")
    parser.seed()
    parser.count("--processes", 2, "that measure")
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
    end(main, "benchmarks.campaign")
