"""``python -m benchmarks.steady_poller PORT RATE``: a Modbus TCP controller that polls so often a second.

It ends with its standard input, and prints as JSON of each poll when it was sent (``time.monotonic``, s), how
long its answer took, s, and the header of the register table, from ``status`` to ``age``.
"""

from __future__ import annotations

import json
import select
import sys
import time

from benchmarks.poller import connected, read_registers

HEADER_REGISTERS = 7


def main() -> int:
    """Poll, and print what came of it."""
    port, period_s = int(sys.argv[1]), 1.0 / float(sys.argv[2])
    polls = []
    with connected(port) as link:
        due_s = time.monotonic()
        while not select.select([sys.stdin], [], [], max(due_s - time.monotonic(), 0.0))[0]:
            sent_s = time.monotonic()
            header = read_registers(link, HEADER_REGISTERS)
            polls.append((sent_s, time.monotonic() - sent_s, *header))
            due_s = max(due_s + period_s, sent_s)
    print(json.dumps(polls))
    return 0


if __name__ == "__main__":
    sys.exit(main())
