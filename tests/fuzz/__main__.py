"""``make fuzz``: each target, or one, for a time; exit status 1 when something was found."""

import argparse
import random

from fuzz.loop import Finding, fuzz
from fuzz.target import load, names


def main() -> int:
    """Run the targets one after the other and say what was tried and found."""
    about = "tries inputs on every target of tests/fuzz/targets"
    parser = argparse.ArgumentParser(prog="fuzz", description=about)
    parser.add_argument("--seconds", type=float, default=600.0, help="time for each target, default 600")
    parser.add_argument("--target", choices=names(), help="this one only")
    parser.add_argument("--seed", type=int, help="first seed, to repeat a run; default another one each time")
    options = parser.parse_args()
    first_seed = random.randrange(1 << 32) if options.seed is None else options.seed
    found = 0
    for name in names() if options.target is None else [options.target]:
        tally = fuzz(load(name), options.seconds, lambda finding, name=name: _say(name, finding), first_seed)
        rate = tally.inputs / max(tally.seconds, 1e-9)
        print(
            f"{name}: {tally.inputs} inputs in {tally.seconds:.0f} s, {rate:.0f} a second, "
            f"{len(tally.findings)} findings (seed {first_seed})",
            flush=True,
        )
        found += len(tally.findings)
    return int(found > 0)


def _say(name: str, finding: Finding) -> None:
    print(f"{name}: FOUND\n{finding}", flush=True)


raise SystemExit(main())
