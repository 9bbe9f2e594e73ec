"""A daemon that is held and resumed, as on a suspended computer, and controllers that poll meanwhile."""

import contextlib
import http.client
import json
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

OF_LATE_FRAMES = {"out_of_step", "warming_up", "stale", "front_camera_silent", "rear_camera_silent"}
"""Reasons where the computer has too little time for cameras that are programs or drivers on it."""
_ANSWER_WITHIN_S = 20.0
_VALID_AGAIN_S = 60.0


@dataclass(frozen=True)
class Answer:
    """The result of one poll: validity and the age of the measurement at that moment, s."""

    face: str
    valid: bool
    age_s: float


def hold(pid: int, modbus_port: int, http_port: int, hold_s: float, polls_s: float) -> list[Answer]:
    """Stop the process for ``hold_s``, resume it, and poll both interfaces as fast as they answer meanwhile.

    Each interface has a request waiting before the process is resumed, and is polled until it is valid again.
    """
    answers: list[Answer] = []
    with _modbus(modbus_port) as read_registers, _http(http_port) as get:
        until_s = time.monotonic() + hold_s + polls_s
        pollers = [
            threading.Thread(target=_poll, args=(ask, until_s, answers)) for ask in (read_registers, get)
        ]
        os.kill(pid, signal.SIGSTOP)
        try:
            for poller in pollers:
                poller.start()
            time.sleep(hold_s)
        finally:
            os.kill(pid, signal.SIGCONT)
        for poller in pollers:
            poller.join()
    return answers


def _poll(ask: Callable[[], Answer], until_s: float, answers: list[Answer]) -> None:
    answers.append(answer := ask())
    while time.monotonic() < until_s + (0.0 if answer.valid else _VALID_AGAIN_S):
        answers.append(answer := ask())


@contextlib.contextmanager
def _modbus(port: int) -> Iterator[Callable[[], Answer]]:
    """Status word and age in ms: registers 0 and 6 of docs/modbus.md."""
    with socket.create_connection(("127.0.0.1", port), timeout=_ANSWER_WITHIN_S) as link:

        def ask() -> Answer:
            link.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 7))
            answer = b""
            while len(answer) < 9 + 14:
                answer += link.recv(256)
            status, *_, age_ms = struct.unpack(">7H", answer[9:])
            return Answer("modbus", bool(status & 1), age_ms * 1e-3)

        ask()
        yield ask


@contextlib.contextmanager
def _http(port: int) -> Iterator[Callable[[], Answer]]:
    """The monotonic clock is one for the whole computer.

    How long the daemon took to answer is not known: the age when it was asked is the least that it can be,
    and the whole of it for what was asked while it ran.
    """
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_ANSWER_WITHIN_S)
    connection.connect()

    def ask() -> Answer:
        connection.request("GET", "/api/measurement")
        asked_s = time.monotonic()
        try:
            said: dict[str, Any] = json.loads(connection.getresponse().read())
        except (
            ConnectionResetError
        ):  # held for longer than the daemon waits for a request: a client asks again
            connection.close()
            return ask()
        return Answer("http", said.get("valid", False), asked_s - said["t_s"])

    try:
        yield ask
    finally:
        connection.close()
