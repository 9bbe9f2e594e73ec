"""Runs every error on every wire, and counts which the reader's checks detect."""

import json
import os
import queue
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from types import SimpleNamespace
from typing import Any

from benchmarks.harness import ROOT, reporter
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

PROOF_CODE = ROOT / "docs/proof/check.py"


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
            self.good_refused.update([fault] if fault else [])
            return
        self.injected += 1
        if self.error == "loss" and lost:
            fault = fault or "lost"
        self.found.update([fault] if fault else [])
        self.passed += not fault


Judge = Callable[[bytes | None], tuple[str, int]]


class Units:
    """Far ends of the wires of both units. A terminal is for one error, those of the second unit for all."""

    def __init__(
        self, terminals: list[dict[str, list[tuple[int, int]]]], ports: list[dict[str, int]]
    ) -> None:
        self._terminals, self._ports = terminals, ports

    def client(self, wire: str, unit: int, place: int) -> Client:
        """Modbus client of a unit."""
        if wire == "Modbus TCP":
            return TcpClient(self._ports[unit]["tcp"])
        return RtuClient(self._terminals[unit]["rtu"][place][0])

    def messages(self, wire: str, unit: int, place: int) -> Iterator[bytes]:
        """Unsolicited messages of a unit."""
        if wire == "telegram":
            return telegrams(self._terminals[unit]["telegram"][place][0])
        return stream(self._ports[unit]["http"])


@contextmanager
def _served() -> Iterator[Units]:
    """Run both units in a process of their own within the block."""
    terminals = [
        {kind: [raw_terminal() for _ in range(count)] for kind in ("telegram", "rtu")}
        for count in (len(ERRORS), 1)
    ]
    devices = [
        {kind: [os.ttyname(end) for _, end in ends] for kind, ends in of_unit.items()}
        for of_unit in terminals
    ]
    with reporter("benchmarks.wire_errors.served", json.dumps(devices)) as process:
        process.await_text("\n")
        yield Units(terminals, json.loads(process.output))


def run(count: int, seed: int, show: Callable[[str], None]) -> list[Tally]:
    """Run every error ``count`` times on every wire, all at the same time."""
    tallies = [Tally(wire, error) for wire in WIRES for error in ERRORS]
    failed: list[BaseException] = []
    with _served() as units:

        def work(tally: Tally) -> None:
            try:
                (_polled if tally.wire.startswith("Modbus") else _pushed)(units, tally, count, seed)
            except BaseException as error:
                failed.append(error)

        threads = [threading.Thread(target=work, args=(tally,), daemon=True) for tally in tallies]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) and not failed:
            time.sleep(0.2)
            show(f"{sum(tally.injected for tally in tallies)} of {count * len(tallies)}")
        if failed:
            raise failed[0]
    return tallies


def _place(error: str) -> int:
    return list(ERRORS).index(error)


def _chance(tally: Tally, seed: int) -> Random:
    return Random(f"{seed} {tally.wire} {tally.error}")


def _polled(units: Units, tally: Tally, count: int, seed: int) -> None:
    client = fetch(units.client(tally.wire, 0, _place(tally.error)))
    other = fetch(units.client(tally.wire, 1, 0)) if tally.error == "wrong address" else client
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


def _pushed(units: Units, tally: Tally, count: int, seed: int) -> None:
    source = Newest(units.messages(tally.wire, 0, _place(tally.error)))
    is_foreign = tally.error == "wrong address"
    other = Newest(units.messages(tally.wire, 1, 0)) if is_foreign else source
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
