"""Runs every error on every wire, and counts which the reader's checks detect."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

from benchmarks.wire_errors.errors import BLOCK, ERRORS, JSON, LIMIT_S, TELEGRAM, Line, Payload
from benchmarks.wire_errors.polled import (
    Client,
    Newest,
    Relay,
    RtuClient,
    TcpClient,
    fetch,
    raw_terminal,
    rtu_proxy,
    stream,
    stream_wire,
    tcp_proxy,
    telegram_wire,
    telegrams,
)
from benchmarks.wire_errors.served import SERIALS

PROOF_CODE = Path(__file__).parents[2] / "docs" / "proof" / "check.py"


def reader() -> Any:
    """Definitions of ``docs/proof/check.py``; it contains nothing of altd.

    These are ``Check``, ``from_block``, ``from_telegram`` and ``from_json``.
    """
    source = PROOF_CODE.read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(compile(source, str(PROOF_CODE), "exec"), names)  # noqa: S102  a file of this project
    return SimpleNamespace(**names)


WIRES = ("Modbus TCP", "Modbus RTU", "telegram", "JSON stream")

_POLL_TIMEOUT_S = 0.3
_SETTLE_S = 0.5
_MAX_STALL_S = 60.0


@dataclass(slots=True)
class Tally:
    """One error on one wire: detections by check, undetected errors, and good messages refused."""

    wire: str
    error: str
    injected: int = 0
    found: Counter[str] = field(default_factory=Counter)
    passed: int = 0
    good: int = 0
    good_refused: Counter[str] = field(default_factory=Counter)

    def add(self, is_spoilt: bool, fault: str, lost: int) -> None:
        """Add the reader's verdict on one delivery; ``lost``: number of messages lost before it."""
        if not is_spoilt:
            self.good += 1
            if fault:
                self.good_refused[fault] += 1
            return
        self.injected += 1
        if self.error == "loss" and not fault and lost:
            fault = "lost"
        if fault:
            self.found[fault] += 1
        else:
            self.passed += 1


Judge = Callable[[bytes | None], tuple[str, int]]


class Unit:
    """The process with both units, and the far ends of their wires."""

    def __init__(self) -> None:
        self._terminals = {
            (unit, kind): [raw_terminal() for _ in (ERRORS if unit == 0 else [""])]
            for unit in (0, 1)
            for kind in ("telegram", "rtu")
        }
        devices = [
            {
                kind: [os.ttyname(end) for _, end in self._terminals[unit, kind]]
                for kind in ("telegram", "rtu")
            }
            for unit in (0, 1)
        ]
        command = [sys.executable, "-m", "benchmarks.wire_errors.served", json.dumps(devices)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        assert self._process.stdout is not None  # noqa: S101  it is a pipe
        self._ports = json.loads(self._process.stdout.readline())

    def client(self, wire: str, unit: int, place: int) -> Client:
        """Modbus client of a unit."""
        if wire == "Modbus TCP":
            return TcpClient(self._ports[unit]["tcp"])
        return RtuClient(self._terminals[unit, "rtu"][place][0])

    def messages(self, wire: str, unit: int, place: int) -> Iterator[bytes]:
        """Unsolicited messages of a unit."""
        if wire == "telegram":
            return telegrams(self._terminals[unit, "telegram"][place][0])
        return stream(self._ports[unit]["http"])

    def end(self) -> None:
        """End the process."""
        self._process.communicate(timeout=30)


def run(count: int, seed: int, show: Callable[[str], None]) -> list[Tally]:
    """Run every error ``count`` times on every wire, all at the same time."""
    unit = Unit()
    tallies = [Tally(wire, error) for wire in WIRES for error in ERRORS]
    failed: list[BaseException] = []

    def work(tally: Tally) -> None:
        try:
            (_polled if tally.wire.startswith("Modbus") else _pushed)(unit, tally, count, seed)
        except BaseException as error:
            failed.append(error)
            raise

    threads = [threading.Thread(target=work, args=(tally,), daemon=True) for tally in tallies]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) and not failed:
        time.sleep(0.2)
        show(f"{sum(tally.injected for tally in tallies)} of {count * len(tallies)}")
    unit.end()
    if failed:
        raise failed[0]
    return tallies


def _place(error: str) -> int:
    return list(ERRORS).index(error)


def _chance(tally: Tally, seed: int) -> Random:
    return Random(f"{seed} {tally.wire} {tally.error}")


def _polled(unit: Unit, tally: Tally, count: int, seed: int) -> None:
    client = fetch(unit.client(tally.wire, 0, _place(tally.error)))
    other = fetch(unit.client(tally.wire, 1, 0)) if tally.error == "wrong address" else client
    deliveries = ERRORS[tally.error](Line(client, other, BLOCK, _chance(tally, seed), is_polled=True))
    truth: queue.Queue[bool] = queue.Queue()
    asking: Client
    if tally.wire == "Modbus TCP":
        asking = TcpClient(tcp_proxy(deliveries, truth))
    else:
        asking = RtuClient(rtu_proxy(deliveries, truth))
    judge = _judge("from_block")
    is_told = True
    while tally.injected < count:
        answer = asking.ask(_POLL_TIMEOUT_S)
        is_spoilt = truth.get(timeout=_MAX_STALL_S)
        # a message that repeats, overtakes or follows a late one is not such an error
        if is_told or not is_spoilt:
            tally.add(is_spoilt, *(("time-out", 0) if answer is None else judge(answer)))
        is_told = answer is not None or is_spoilt
    asking.close()


def _pushed(unit: Unit, tally: Tally, count: int, seed: int) -> None:
    source = Newest(unit.messages(tally.wire, 0, _place(tally.error)))
    is_foreign = tally.error == "wrong address"
    other = Newest(unit.messages(tally.wire, 1, 0)) if is_foreign else source
    payload, wire, read = _OF_PUSHED[tally.wire]
    time.sleep(_SETTLE_S)
    source.drop()  # drop messages from before the reader: it begins on an empty line
    line = Line(source.take, other.take, payload, _chance(tally, seed), is_polled=False)
    write, received = wire()
    relay = Relay(ERRORS[tally.error](line), source, write)
    judge = _judge(read)
    for message in received:
        tally.add(relay.truth.get(timeout=_MAX_STALL_S), *judge(message))
        if tally.injected >= count:
            return
        relay.judged.release()


_OF_PUSHED: dict[str, tuple[Payload, Callable[[], tuple[Callable[[bytes], None], Iterator[bytes]]], str]] = {
    "telegram": (TELEGRAM, telegram_wire, "from_telegram"),
    "JSON stream": (JSON, stream_wire, "from_json"),
}


def _judge(read: str) -> Judge:
    """Reader of the page for the first unit."""
    code = reader()
    check = code.Check(zlib.crc32(SERIALS[0].encode()), LIMIT_S)

    def judge(content: bytes | None) -> tuple[str, int]:
        fault: str = check.fault(getattr(code, read)(content), time.monotonic())
        return fault, check.lost

    return judge
