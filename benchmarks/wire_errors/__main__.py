"""``python -m benchmarks.wire_errors`` (``make bench-wires``): errors on every wire, and their detection."""

from collections import Counter
from collections.abc import Iterable, Sequence

from benchmarks.harness import Columns, Parser, end, markdown_table, show, write_page
from benchmarks.wire_errors.errors import ERRORS, HOLD_S, LIMIT_S
from benchmarks.wire_errors.runner import WIRES, Tally, run
from benchmarks.wire_errors.served import RATE_HZ

_TABLE = Columns("error:<15", "wire:<13", "injected:>9", "found:>7", "passed:>7", "  by:")


def text(tallies: Sequence[Tally]) -> Iterable[str]:
    """Lines for a terminal."""
    yield _TABLE.head
    for tally in tallies:
        by = f"  {_by(tally.found)}; good {tally.good}, refused {_by(tally.good_refused) or 0}"
        yield _TABLE.row(tally.error, tally.wire, tally.injected, tally.found.total(), tally.passed, by)


def passed(tallies: Iterable[Tally]) -> int:
    """Number of errors that the reader accepted as good messages."""
    return sum(tally.passed for tally in tallies)


def page(tallies: Sequence[Tally], command: str) -> str:
    """Page as Markdown; its third line is the headline."""
    injected, missed = sum(tally.injected for tally in tallies), passed(tallies)
    good = sum(tally.good for tally in tallies)
    refused = sum((tally.good_refused for tally in tallies), Counter[str]())
    of = {(tally.error, tally.wire): _cell(tally) for tally in tallies}
    cells = markdown_table(
        ("error", *WIRES), [(error, *(of[error, wire] for wire in WIRES)) for error in ERRORS], 5
    )
    rejected = _by(refused) or "none"
    headline = f"[check of a message](../proof.md) found {injected - missed:,}; {missed:,} passed."
    return f"""# Wire errors: what a reader of the unit finds

Of {injected:,} errors put on four wires the {headline}

Command: `{command}`.

Two units with all their interfaces run in a process of their own, {RATE_HZ:g} measurements a second. A
proxy on real wires (TCP connections, pseudo terminals, an HTTP stream) makes every second message an error.
The reader is the Python code on the page [proof](../proof.md), without altd. Its clock is not synchronised,
and it accepts nothing older than {LIMIT_S:g} s. The proxy corrects the checks of the wires themselves
(CRC-16 of Modbus RTU, checksums of NMEA 0183 and TCP, transaction numbers), so that these find nothing.

{cells}

A cell: errors found of errors injected, and by which check.

- *corruption*: 1 to 100 inverted bits. *repetition*: the last message again. *insertion*: one of the last 50.
  *wrong order*: two messages exchanged. *wrong address*: a good message of a second unit of the same kind.
- *loss*: Modbus gives no answer, which is a time-out. In telegram and stream the next message shows the gap
  in `message` or `published` (*lost*).
- *delay*: held for {HOLD_S:g} s, so that age and delay exceed the limit.
- *masquerade*: a sender with the unit's number and a right checksum of the wire that does not compute the
  CRC-32, or another device at the same address. A sender that computes it is not detected.

Delay is counted from the reader's first message, which must not be delayed.

Of {good:,} good messages between the errors {refused.total():,} were rejected: {rejected}.
A good message that is rejected as *late* or by time-out was late because the machine had other work. An error
directly after a time-out is not counted.
"""


def _cell(tally: Tally) -> str:
    by = _by(tally.found, numbered=len(tally.found) > 1)
    return f"{tally.found.total():,}/{tally.injected:,}: {by}"


def _by(counts: Counter[str], numbered: bool = True) -> str:
    return ", ".join(f"{name} {count:,}" if numbered else name for name, count in counts.most_common())


def main(arguments: list[str] | None = None) -> int:
    """Run and print the table; return 1 if an error was accepted as a good message."""
    parser = Parser("benchmarks.wire_errors", __doc__)
    parser.count("--count", 1000, "of each error on each wire")
    parser.seed()
    parser.page()
    options = parser.parse_args(arguments)
    tallies = run(options.count, options.seed, show)
    show("")
    print("\n".join(text(tallies)))
    if options.page is not None:
        command = f"python -m benchmarks.wire_errors --count {options.count} --seed {options.seed}"
        write_page(options.page, page(tallies, command))
    return 1 if passed(tallies) else 0


if __name__ == "__main__":
    end(main, "benchmarks.wire_errors")
