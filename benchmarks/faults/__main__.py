"""``python -m benchmarks.faults`` (``make faults``): disturb the whole daemon and judge all its outputs."""

import argparse
import contextlib
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from altd.errors import BadInputError
from benchmarks.campaign.clips import SimulatedRig, rig_of
from benchmarks.campaign.units import NAMES
from benchmarks.campaign.ways import chosen, listed
from benchmarks.faults import real, tables
from benchmarks.faults.catalogue import FAULTS, Fault
from benchmarks.faults.episode import drawn, run_episode
from benchmarks.faults.tables import Run
from benchmarks.harness import Parser, end, show, write_page
from benchmarks.interfaces import BROKER, broker, interfaces
from hw_sim.ports import free_port

UNITS = ("flat", "plain", "bits-12", "shaking", "ellipse", "dusty")
_PAIRS = 5
"""One of this number of runs has two faults at once."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print the table; return 1 if a detectable fault gave a wrong value or no reason, or lasted."""
    parser = Parser("benchmarks.faults", __doc__)
    parser.count("--runs", 40, "on the set clock", least=0)
    parser.count("--real", 0, "of each fault of a process, in real time", least=0)
    parser.seed()
    parser.add_argument("--only", default="", metavar="NAME,...", help="faults or groups; --list shows them")
    parser.names("--units", NAMES, "units of the campaign", UNITS)
    parser.file("--results", "keep the runs in a file, or continue it")
    parser.page()
    parser.add_argument("--list", action="store_true", help="show the faults and end")
    options = parser.parse_args(arguments)
    if options.list:
        print(listed(FAULTS))
        return 0
    logging.getLogger("altd").setLevel(logging.CRITICAL)
    cv2.setNumThreads(1)
    began_s = time.monotonic()
    runs = list(_runs(options))
    took_s = time.monotonic() - began_s
    print("\n".join(tables.text(runs)))
    if options.page is not None:
        command = f"python -m benchmarks.faults --runs {options.runs} --real {options.real}"
        command += f" --seed {options.seed}" + f" --only {options.only}" * bool(options.only)
        write_page(options.page, tables.page(runs, command))
    print(f"{len(runs)} runs, seed {options.seed}, {took_s:.0f} s")
    return 1 if any(tables.failures(run) for run in runs) else 0


def _runs(options: argparse.Namespace) -> Iterator[Run]:
    """All runs in order; runs of an earlier call are read from the file of results."""
    faults, units = chosen(options.only, FAULTS, "--only", "fault"), options.units
    known = {}
    if options.results is not None and options.results.exists():
        known = {run.number: run for run in map(Run.of_json, options.results.read_text().splitlines())}
    broker_port = free_port()
    with broker(broker_port) if BROKER else contextlib.nullcontext():
        wanted = [*range(options.runs), *range(-options.real * len(real.FAULTS), 0)]
        for count, number in enumerate(wanted, start=1):
            run = known.get(number)
            if run is None:
                if number < 0:
                    name = tuple(real.FAULTS)[number % len(real.FAULTS)]
                    run = Run(number, "in real time", (name,), "", "", False, real.run_real(name))
                else:
                    run = _run(number, options.seed, faults, units, broker_port)
                if options.results is not None:
                    with options.results.open("a") as file:
                        file.write(run.as_json() + "\n")
            show(f"{count} of {len(wanted)} runs: {', '.join(run.names)}" if count < len(wanted) else "")
            yield run


def _run(number: int, seed: int, faults: Sequence[Fault], units: Sequence[str], broker_port: int) -> Run:
    """Run once with its own seed; faults alternate, a second one is drawn."""
    rng = np.random.default_rng([seed, number])
    unit = units[int(rng.integers(len(units)))]
    rig = rig_of(unit)
    if not isinstance(rig, SimulatedRig):
        raise BadInputError("--units", f"{unit} is not simulated")
    together = [faults[number % len(faults)]]
    if (number + number // len(faults)) % _PAIRS == _PAIRS - 1 and len(faults) > 1:  # not always the same
        others = [fault for fault in faults if fault is not together[0]]
        together.append(others[int(rng.integers(len(others)))])
    made = drawn(together, rig, rng)
    with interfaces(1) as places:  # on new ports: another program may have taken the previous ones
        del places.tables["opcua"]
        places.tables["mqtt"]["port"] = broker_port
        if not BROKER:
            del places.tables["mqtt"]
        result = run_episode(rig, made, rng, replace(places, mqtt_port=broker_port), bool(BROKER))
    return Run(number, unit, made.names, made.note, made.undetectable, made.is_blind, result)


if __name__ == "__main__":
    end(main, "benchmarks.faults")
