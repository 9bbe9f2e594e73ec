"""``python -m benchmarks.poller PORT SECONDS``: a Modbus TCP controller in a process of its own.

It reads the input registers again and again, after pauses of which no two are alike, and prints as JSON how
long each answer took, ms.
"""

from __future__ import annotations

import json
import random
import socket
import struct
import sys
import time

_HOST = "127.0.0.1"
_REGISTERS = 100
_MIN_PAUSE_S, _MAX_PAUSE_S = 0.002, 0.012


def main() -> int:
    """Poll, and print what came of it."""
    port, seconds = int(sys.argv[1]), float(sys.argv[2])
    generator = random.Random(1)
    waits_ms = []
    with connected(port) as link:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            time.sleep(generator.uniform(_MIN_PAUSE_S, _MAX_PAUSE_S))
            begun_ns = time.monotonic_ns()
            read_registers(link, _REGISTERS)
            waits_ms.append((time.monotonic_ns() - begun_ns) * 1e-6)
    print(json.dumps(waits_ms))
    return 0


def connected(port: int, timeout_s: float = 5.0) -> socket.socket:
    """A connection to a server that may still be starting."""
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


def read_registers(link: socket.socket, count: int) -> tuple[int, ...]:
    """The first input registers (function 4); raises ConnectionError for any other answer."""
    link.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, count))
    wanted, answer = 9 + 2 * count, b""
    while len(answer) < wanted and (data := link.recv(wanted - len(answer))):
        answer += data
    if len(answer) != wanted or answer[7] != 4:
        raise ConnectionError(answer.hex())
    return struct.unpack(f">{count}H", answer[9:])


if __name__ == "__main__":
    sys.exit(main())
