"""A controller's view of the unit: each measurement of the stream, and Modbus answers at the same time.

It also covers faults of the cameras as in the tunnel: the times to detection and to recovery.
"""

import http.client
import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

from benchmarks.harness import HOST
from benchmarks.poller import connected, read_registers
from hw_sim.ports import free_port

_POLL_INTERVAL_S = 0.05
_ANSWER_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class Ports:
    """The TCP ports of a unit's interfaces."""

    http: int
    modbus: int

    @classmethod
    def free(cls) -> Self:
        """Ports that are currently free."""
        return cls(free_port(), free_port())


@dataclass(frozen=True, slots=True)
class Received:
    """A measurement of the stream, and its arrival on the monotonic clock."""

    arrived_s: float
    measurement: dict[str, Any]

    @property
    def valid(self) -> bool:
        """Whether the unit marks it valid."""
        return bool(self.measurement["valid"])

    @property
    def reasons(self) -> frozenset[str]:
        """Status codes without those of its origin."""
        return frozenset(self.measurement["status"]) - {"playback", "simulated"}


@dataclass(slots=True)
class Polled:
    """Modbus answers: time of the request, response time, status word."""

    asked_s: list[float] = field(default_factory=list)
    took_s: list[float] = field(default_factory=list)
    status: list[int] = field(default_factory=list)


class Watch:
    """``with Watch(ports) as watch``: two threads that read until the end."""

    def __init__(self, ports: Ports) -> None:
        self.seen: list[Received] = []
        self.polled = Polled()
        self.failure: BaseException | None = None
        self._ports = ports
        self._ended = threading.Event()
        self._news = threading.Condition()
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=work.__name__)
            for work in (self._listen, self._poll)
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def first(self, wanted: Callable[[Received], bool], since_s: float, timeout_s: float) -> Received:
        """First measurement that arrived after ``since_s`` and is ``wanted``; raises TimeoutError."""
        deadline_s = time.monotonic() + timeout_s
        examined = 0
        while self.failure is None and time.monotonic() < deadline_s:
            with self._news:
                if len(self.seen) == examined:
                    self._news.wait(0.1)
            for seen in self.seen[examined:]:
                examined += 1
                if seen.arrived_s > since_s and wanted(seen):
                    return seen
        last = self.seen[-1].measurement if self.seen else None
        raise TimeoutError(f"not within {timeout_s:g} s; the last measurement was {last}") from self.failure

    def status(self) -> dict[str, Any]:
        """Status of the unit with its components."""
        connection = http.client.HTTPConnection(HOST, self._ports.http, timeout=_ANSWER_TIMEOUT_S)
        try:
            connection.request("GET", "/api/status")
            answer: dict[str, Any] = json.loads(connection.getresponse().read())
            return answer
        finally:
            connection.close()

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            if not self._ended.is_set():
                self.failure = error

    def _listen(self) -> None:
        connection = http.client.HTTPConnection(HOST, self._ports.http, timeout=_ANSWER_TIMEOUT_S)
        connection.request("GET", "/api/stream")
        stream = connection.getresponse()
        try:
            while not self._ended.is_set():
                line = stream.readline()
                arrived_s = time.monotonic()
                if line.startswith(b"data: "):
                    with self._news:
                        self.seen.append(Received(arrived_s, json.loads(line[6:])))
                        self._news.notify_all()
                elif not line:
                    raise ConnectionError("the stream ended")
        finally:
            connection.close()

    def _poll(self) -> None:
        with connected(self._ports.modbus, _ANSWER_TIMEOUT_S) as link:
            while not self._ended.wait(_POLL_INTERVAL_S):
                asked_s = time.monotonic()
                registers = read_registers(link)
                self.polled.took_s.append(time.monotonic() - asked_s)
                self.polled.asked_s.append(asked_s)
                self.polled.status.append(registers[0])


_DETECTION_TIMEOUT_S = 5.0
_RECOVERY_TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class Recovery:
    """One fault. Times are those at a reader of the stream.

    ``invalid_after_s`` counts from the fault, ``valid_after_s`` from the camera's return; the slowest answer
    of Modbus is that of the whole time between fault and recovery.
    """

    fault: str
    reasons: tuple[str, ...]
    invalid_after_s: float
    health: str
    valid_after_s: float
    modbus_slowest_ms: float
    modbus_said_invalid: bool


def measure_fault(
    watch: Watch,
    fault: str,
    camera: str,
    inject: Callable[[], object],
    restore: Callable[[], float],
    lasts_s: float,
) -> Recovery:
    """Inject a fault, restore, wait for recovery; ``restore`` returns the time of the camera's return, s."""
    watch.first(lambda seen: seen.valid, time.monotonic(), _RECOVERY_TIMEOUT_S)
    injected_s = time.monotonic()
    inject()
    invalid = watch.first(lambda seen: not seen.valid, injected_s, _DETECTION_TIMEOUT_S)
    time.sleep(max(lasts_s - (time.monotonic() - injected_s), 0.0))
    health = watch.status()["components"][f"camera {camera}"]
    restored_s = restore()
    valid = watch.first(lambda seen: seen.valid, max(restored_s, invalid.arrived_s), _RECOVERY_TIMEOUT_S)
    polled = watch.polled
    answers = [
        (took_s, status)
        for asked_s, took_s, status in zip(polled.asked_s, polled.took_s, polled.status, strict=False)
        if injected_s <= asked_s <= valid.arrived_s
    ]
    return Recovery(
        fault=fault,
        reasons=tuple(sorted(invalid.reasons)),
        invalid_after_s=invalid.arrived_s - injected_s,
        health=f"{health['state']}: {health['message']}",
        valid_after_s=valid.arrived_s - restored_s,
        modbus_slowest_ms=1e3 * max(took_s for took_s, _ in answers),
        modbus_said_invalid=any(not status & 1 for _, status in answers),
    )
