"""``python -m benchmarks.poller MODBUS HTTP LINE``: a controller and other clients in a separate process.

It polls the input registers at a Modbus TCP port, and reads the stream at an HTTP port and the telegrams of a
descriptor, until its standard input ends. Then it prints as JSON how many of each it has got.
"""

import json
import os
import select
import socket
import struct
import sys
import time

from benchmarks.harness import HOST

REGISTERS = 100
READ = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, REGISTERS)
"""Request for the first input registers (function 4)."""
ANSWER_BYTES = 9 + 2 * REGISTERS
POLLS_PER_S = 10


def main() -> int:
    """Poll, and print the result."""
    modbus_port, http_port, line = map(int, sys.argv[1:])
    link, stream = connected(modbus_port), connected(http_port)
    stream.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    heard = {stream.fileno(): ("stream events", b"\ndata: "), line: ("telegrams", b"\r\n")}
    counts = {"modbus answers": 0, "stream events": 0, "telegrams": 0}
    due_s = time.monotonic()
    while True:
        wait_s = max(due_s - time.monotonic(), 0.0)
        ready, _, _ = select.select([sys.stdin.fileno(), *heard], [], [], wait_s)
        if sys.stdin.fileno() in ready:
            print(json.dumps(counts))
            return 0
        for descriptor in ready:
            what, mark = heard[descriptor]
            counts[what] += os.read(descriptor, 65536).count(mark)
        if (now_s := time.monotonic()) >= due_s:
            read_registers(link)
            counts["modbus answers"] += 1
            due_s = max(due_s + 1 / POLLS_PER_S, now_s)


def connected(port: int, timeout_s: float = 5.0) -> socket.socket:
    """Connect to a server that may still be starting."""
    give_up_s = time.monotonic() + timeout_s
    while True:
        try:
            link = socket.create_connection((HOST, port), timeout=timeout_s)
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
