"""The page of a campaign: ``docs/studies/campaign.md``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from altd.errors import BadInputError
from benchmarks.campaign import tally_table
from benchmarks.campaign.catalogue import WAYS
from benchmarks.campaign.judge import Tally
from tools.markdown import wrapped

_HEAD = """\
# Campaign: spoilt measurements, judged by truth

{headline}

Written by `{command}` ({took_s:.0f} s; seed {seed}; units {units}). Each episode draws a unit, a beam, a way
to spoil it and its parameters from the seed; clean exposures come first in four of five, then spoilt ones,
all through the daemon's own measuring chain (window {window}), which measures at every exposure. *Wrong* is
one that is called valid with an error above 5 sigma and above 0.05 mm or 0.01°; where no laser is left, any
number is wrong. *Invalid* are refused ones. *Notice*: frames from the onset to the first invalid measurement,
median / largest; a mean of several exposures is wrong only once enough of them are. *Back*: seconds from the
end of a disturbance to the next valid measurement. Ways of times run through pipeline and board on a clock
that is driven, and a reader of the board is judged every 25 ms: its numbers must be those of some moment
within the last second and a window. Stamps of a clock in the camera are mapped as the GigE driver maps them.

What is *(hidden)* was drawn so that on that unit nobody could see it, by the limits of
`benchmarks/campaign/detectability.py`, which are written down below; such ways were found by this campaign,
and what it counts as wrong rests on where these limits lie.

What it is worth: all but unit-a is simulated, and ways are those that their authors thought of.

"""


@dataclass(frozen=True, slots=True)
class RunDescription:
    """How a campaign was run: its command, the seed and units drawn from, its duration and window."""

    command: str
    seed: int
    units: str
    took_s: float
    window: int


def write_page(path: Path, tallies: Mapping[str, Tally], run: RunDescription) -> None:
    """Write the page; raises BadInputError when the disk refuses."""
    wrong = tally_table.wrong_count(tallies)
    total = sum(tally.measurements + tally.clean for tally in tallies.values())
    ways = {name.removesuffix(tally_table.HIDDEN_SUFFIX) for name in tallies} & WAYS.keys()
    headline = (
        f"Of {total:,} measurements in {len(ways)} ways, and in pairs of them, {wrong:,} wrong ones were "
        f"called valid, beside {tally_table.invisible_count(tallies):,} where nobody could tell (marked *)."
    )
    text = _HEAD.format(headline=headline, **asdict(run))
    head, *rows = tally_table.rows(tallies)
    lines = ["| " + " | ".join(head) + " |", "|---|---|" + "---:|" * (len(head) - 2)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    hidden = [f"- {line[2:]}" for line in tally_table.invisible(tallies)]
    if hidden:
        lines += ["", "What physics forbids to see (marked *), with its size:", "", *hidden]
    lines += ["", *(f"- {line}." for line in tally_table.totals(tallies)), "", "## The ways", ""]
    lines += [f"- `{name}` ({way.kind}): {_first_line(way.make)}" for name, way in WAYS.items()]
    try:
        path.write_text(wrapped(text + "\n".join(lines) + "\n"))
    except OSError as error:
        raise BadInputError(path, f"cannot be written: {error.strerror or error}") from error


def _first_line(make: object) -> str:
    return (make.__doc__ or "Nothing is spoilt.").strip().splitlines()[0]
