"""``python -m benchmarks.poller PORT``: a Modbus TCP controller and other clients in a separate process.

It reads the input registers until its standard input ends. Then it prints as JSON for each poll its time
(``time.monotonic``, s), its response time, s, and the header of the register table, from ``status`` to
``age``; and the numbers of events and telegrams received.
"""

import json
import os
import random
import select
import socket
import struct
import sys
import time

from benchmarks.harness import Parser

REGISTERS = 100
HEADER_REGISTERS = 7
READ = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, REGISTERS)
"""Request for the first input registers (function 4)."""
ANSWER_BYTES = 9 + 2 * REGISTERS

_HOST = "127.0.0.1"
_MIN_PAUSE_S, _MAX_PAUSE_S = 0.002, 0.012


def main() -> int:
    """Poll, and print the result."""
    parser = Parser("benchmarks.poller", __doc__)
    parser.add_argument("port", type=int)
    parser.number("--rate", None, "polls a second; default: pauses of which no two are alike", "HZ")
    parser.add_argument("--http", type=int, metavar="PORT", help="read the stream of measurements there")
    parser.add_argument("--line", type=int, metavar="DESCRIPTOR", help="read the telegrams of a terminal")
    options = parser.parse_args()
    generator = random.Random(1)
    polls: list[tuple[float, ...]] = []
    link = connected(options.port)
    heard: dict[int, tuple[str, bytes]] = {}
    if options.http is not None:
        stream = connected(options.http)
        stream.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
        heard[stream.fileno()] = "stream events", b"\ndata: "
    if options.line is not None:
        heard[options.line] = "telegrams", b"\r\n"
    counts = dict.fromkeys((what for what, _ in heard.values()), 0)
    due_s = time.monotonic()
    while True:
        wait_s = max(due_s - time.monotonic(), 0.0)
        ready, _, _ = select.select([sys.stdin.fileno(), *heard], [], [], wait_s)
        if sys.stdin.fileno() in ready:
            print(json.dumps({"polls": polls, **counts}))
            return 0
        for descriptor in ready:
            what, mark = heard[descriptor]
            counts[what] += os.read(descriptor, 65536).count(mark)
        sent_s = time.monotonic()
        if sent_s >= due_s:
            registers = read_registers(link)
            answered_s = time.monotonic()
            polls.append((sent_s, answered_s - sent_s, *registers[:HEADER_REGISTERS]))
            if options.rate is None:
                due_s = answered_s + generator.uniform(_MIN_PAUSE_S, _MAX_PAUSE_S)
            else:
                due_s = max(due_s + 1 / options.rate, sent_s)


def connected(port: int, timeout_s: float = 5.0) -> socket.socket:
    """Connect to a server that may still be starting."""
    give_up_s = time.monotonic() + timeout_s
    while True:
        try:
            link = socket.create_connection((_HOST, port), timeout=timeout_s)
        except ConnectionRefusedError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.02)
        else:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return link


def read_registers(link: socket.socket) -> tuple[int, ...]:
    """Read the first input registers; raises ConnectionError for any other answer."""
    link.sendall(READ)
    answer = received(link, ANSWER_BYTES)
    if answer[7] != 4:
        raise ConnectionError(answer.hex())
    return struct.unpack(f">{REGISTERS}H", answer[9:])


def received(link: socket.socket, length: int) -> bytes:
    """Receive ``length`` bytes; raises ConnectionError if the other side closes before."""
    heard = b""
    while len(heard) < length:
        piece = link.recv(length - len(heard))
        if not piece:
            raise ConnectionError(f"it was closed after {heard.hex()}")
        heard += piece
    return heard


if __name__ == "__main__":
    sys.exit(main())
