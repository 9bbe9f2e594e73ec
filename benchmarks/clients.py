"""``python -m benchmarks.clients``: a controller, a browser and a serial listener, in a process of their own.

Arguments: Modbus port, HTTP port, the far end of a pseudo terminal as an inherited file descriptor. Reads
until stdin ends, then prints how often each of them was answered, as JSON.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import struct
import sys
import time

POLLS_PER_S = 10
_REGISTERS = 100
_HOST = "127.0.0.1"


def main() -> int:
    """Attach, read, and say what came."""
    modbus_port, http_port, line = (int(argument) for argument in sys.argv[1:4])
    modbus = _connected(modbus_port)
    stream = _connected(http_port)
    stream.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    answers = {"modbus answers": 0, "stream events": 0, "telegrams": 0}
    selector = selectors.DefaultSelector()
    for source in (stream.fileno(), line, sys.stdin.fileno()):
        selector.register(source, selectors.EVENT_READ)
    next_poll_s = time.monotonic()
    while True:
        wait_s = next_poll_s - time.monotonic()
        if wait_s <= 0:
            answers["modbus answers"] += _poll(modbus)
            next_poll_s += 1 / POLLS_PER_S
            continue
        for key, _ in selector.select(wait_s):
            data = os.read(key.fd, 65536)
            if key.fd == sys.stdin.fileno() and not data:
                print(json.dumps(answers))
                return 0
            if key.fd == stream.fileno():
                answers["stream events"] += data.count(b"\ndata: ")
            elif key.fd == line:
                answers["telegrams"] += data.count(b"\r\n")


def _connected(port: int, timeout_s: float = 5.0) -> socket.socket:
    """A connection to a server that may still be starting."""
    give_up_s = time.monotonic() + timeout_s
    while True:
        try:
            return socket.create_connection((_HOST, port), timeout=timeout_s)
        except ConnectionRefusedError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.02)


def _poll(connection: socket.socket) -> int:
    """Read the input registers once (function 4); 1 when the answer has all of them."""
    connection.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, _REGISTERS))
    wanted, answer = 9 + 2 * _REGISTERS, b""
    while len(answer) < wanted and (data := connection.recv(wanted - len(answer))):
        answer += data
    return int(len(answer) == wanted and answer[7] == 4)


if __name__ == "__main__":
    sys.exit(main())
