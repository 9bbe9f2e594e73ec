"""The MQTT client of ``examples/``: true, forged, late and retained messages, and the real daemon."""

import importlib.util
import json
import queue
import random
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import CallbackAPIVersion, Client, MQTTv5
from support import example_clients as clients
from support.example_clients import Verdict
from support.foreign import need_program
from support.measurements import measured, measurement
from support.mqtt import mosquitto
from support.places import EXAMPLES
from support.played_unit import PlayedUnit, playing
from support.scripted_unit import SERIAL, SESSION, UNIT, flipped, refused

from altd.instruments.beam.solver import Beam
from altd.reasons import Reason
from altd.records import Measurement
from altd.status.measurement_json import as_object_now

PROGRAM = EXAMPLES / "python" / "read_mqtt.py"
VALUES = pytest.approx((10.012, 4.987, 1.1459, -1.7184), abs=1e-4)
TRUTH = pytest.approx((10.0, 5.0, 1.1458, -1.7184), abs=0.02)
EPOCH = datetime(2026, 11, 23, tzinfo=UTC)
TRUE = measurement()
OTHER = measured(Beam(99.0, 99.0, 9.0, 9.0, 0.004, 0.004, 0.0011, 0.0011))
"""Values that must never come through."""
GOOD, OFFLINE, ACKNOWLEDGED = "good", b"offline", b""


class Retained(bytes):
    """A message that comes from the broker's memory."""


def message(
    number: int, age_ms: float = 60, of: Measurement = TRUE, at: datetime = EPOCH, **changes: Any
) -> bytes:
    """As the unit sends it, 100 ms after the one before; ``changes`` are forged keys, with their CRC."""
    captured = at + timedelta(milliseconds=100 * number - age_ms)
    told = as_object_now(replace(of, time=captured), age_ms / 1e3)
    told |= {"unit": f"{UNIT:08X}", "session": f"{SESSION:08X}", "message": number, "published": number}
    told |= {"clock_ms": 7000 + 100 * number, "age_s": age_ms / 1e3} | changes
    line = json.dumps(told).removesuffix("}")
    return f'{line}, "crc32": "{zlib.crc32(line.encode()):08X}"}}'.encode()


def reader(limit_ms: float, rehearsal: bool, unit: int = UNIT) -> Any:
    """The example's ``Target``."""
    spec = importlib.util.spec_from_file_location("read_mqtt", PROGRAM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Target(f"{unit:08X}", limit_ms, rehearsal)


def judged(
    polls: Sequence[tuple[float, bytes | None]],
    rehearsal: bool = False,
    utc_error_ms: float = 0.0,
    limit_ms: float = 500.0,
) -> list[Verdict]:
    """The verdict at each time in ms; ``ACKNOWLEDGED`` goes with the next message."""
    target = reader(limit_ms, rehearsal)
    verdicts, acknowledged = [], False
    for now_ms, payload in polls:
        if payload != ACKNOWLEDGED:
            utc_ms = EPOCH.timestamp() * 1e3 + now_ms + utc_error_ms
            is_retained = isinstance(payload, Retained)
            fault = target.update(payload, is_retained, 1e7 + now_ms, utc_ms, acknowledged)
            verdicts.append((fault, None if target.values is None else tuple(target.values)))
        acknowledged = payload == ACKNOWLEDGED
    return verdicts


def usable(polls: Sequence[tuple[float, bytes | None]], **how: Any) -> list[tuple[str, bool]]:
    return [(fault, values is not None) for fault, values in judged(polls, **how)]


TABLE: tuple[tuple[bytes | None, str, bool], ...] = (
    (Retained(message(1, of=OTHER)), "retained", False),
    (message(2), GOOD, True),
    (message(3), GOOD, True),
    (message(3), "not newer", True),
    (message(2, of=OTHER), "not newer", True),
    (message(3 + 2**31, of=OTHER), "not newer", True),
    (Retained(message(9, of=OTHER)), "retained", True),
    (flipped(message(4, of=OTHER), 480), "corrupt", True),
    (message(4, of=OTHER)[:-30], "corrupt", True),
    (b"\xff" * 160, "corrupt", True),
    (b"null", "corrupt", True),
    (message(4, of=OTHER, message=None), "corrupt", True),
    (message(4, of=OTHER, status=None), "corrupt", True),
    (message(4, of=OTHER, age_s=None), "corrupt", True),
    (message(4, of=OTHER, time=None), "corrupt", True),
    (message(5, of=OTHER, unit="1E4B2D8F"), "foreign", True),
    (message(5, of=OTHER, unit=None), "foreign", True),
    (message(13, 3_600_000, OTHER), "late", True),
    (None, "no answer", True),
    (message(14), GOOD, True),
    (message(15, of=measurement(160, 0, Reason.PLAYBACK, Reason.REHEARSAL)), "not live", False),
    (message(16), GOOD, True),
    (message(17, of=measurement(160, 0, Reason.SIMULATED)), "not live", False),
    (message(18), GOOD, True),
    (message(19, of=measurement(160, 0, Reason.REHEARSAL)), "not live", False),
    (message(20), GOOD, True),
    (message(21, of=refused(Reason.SPOT_MISSING, "front")), "not valid: front_spot_missing", False),
    (message(22, of=refused(Reason.STALE)), "not valid: stale", False),
    (message(23, of=OTHER, x_mm=None), "not valid: unknown_reason", False),
    (message(24, of=OTHER, pitch_deg=float("nan")), "not valid: unknown_reason", False),
    (message(25, of=OTHER, y_mm="99"), "not valid: unknown_reason", False),
    (message(26, of=OTHER, valid=1), "not valid: unknown_reason", False),
    (message(27), GOOD, True),
    (OFFLINE, "offline", False),
    (message(29), GOOD, True),
    (message(30, of=OTHER, session="00000001"), "restarted", False),
    (None, "no answer", False),
    (message(32, of=OTHER, session="00000001"), "restarted", False),
)


def test_it_gives_the_verdicts_of_the_table() -> None:
    expected = [(fault, VALUES if good else None) for _, fault, good in TABLE]
    polls = [(100 * n, said) for n, (said, _, _) in enumerate(TABLE, 1)]
    assert judged(polls, limit_ms=30_000) == expected


def test_values_that_are_not_live_are_used_only_to_rehearse() -> None:
    """The time of a recording is not the current one."""
    for reason in (Reason.PLAYBACK, Reason.SIMULATED, Reason.REHEARSAL):
        polls = [(100, message(1, of=measurement(160, 0, reason), time="2020-01-01T00:00:00.000Z"))]
        assert judged(polls, rehearsal=True) == [(GOOD, VALUES)]
        assert judged(polls) == [("not live", None)]


def test_values_are_dropped_at_the_limit_whatever_comes() -> None:
    """60 ms old when they came at 1000 ms, so they may be used for 440 ms more."""
    for says, fault in ((None, "no answer"), (b"{}", "corrupt"), (message(10), "not newer")):
        polls = [(1000, message(10)), (1439, says), (1440, says), (9999, says)]
        assert usable(polls) == [(GOOD, True), (fault, True), (fault, False), (fault, False)]


def test_what_a_queue_holds_back_is_late_by_either_clock() -> None:
    """The broker comes to deliver each message 450 ms late; then its queue is empty again."""
    polls = [(100 * n, message(n)) for n in range(1, 6)] + [(900, message(6))]
    polls += [(100 * n + 450, message(n)) for n in range(7, 12)]
    polls += [(100 * n, message(n)) for n in range(16, 18)]
    expected = [(GOOD, True)] * 6 + [("late", False)] * 5 + [(GOOD, True)] * 2
    assert usable(polls, utc_error_ms=-10_000) == expected, "by the clock that is never set"
    always_late = [(100 * n + 500, message(n)) for n in range(1, 6)]
    assert usable(always_late) == [("late", False)] * 5, "by UTC: the first message, too"


def test_a_unit_that_sends_but_measures_nothing_has_stopped() -> None:
    polls = [(100 * n, message(n, published=min(n, 3))) for n in range(1, 10)]
    assert usable(polls) == [(GOOD, True)] * 8 + [("stopped", False)]


def test_a_unit_that_was_restarted_or_silent_is_refused_until_an_operator_acknowledges_it() -> None:
    again = {"session": "00000001"}
    polls = [(100, message(1)), (200, message(2, **again)), (250, ACKNOWLEDGED), (300, message(3, **again))]
    polls += [(1000, message(10, **again)), (1050, ACKNOWLEDGED), (1100, message(11, **again))]
    assert [fault for fault, _ in judged(polls)] == [GOOD, "restarted", GOOD, "silent", GOOD]


def test_any_corruption_of_a_message_is_found() -> None:
    chance = random.Random(1)
    bits = 8 * len(message(2))
    spoilt = [
        flipped(message(2), *chance.sample(range(bits), chance.choice((1, 1, 2, 3, 9)))) for _ in range(50)
    ]
    polls = [(100.0, said) for said in (message(1), *spoilt, message(2))]
    assert [fault for fault, _ in judged(polls)] == [GOOD, *["corrupt"] * 50, GOOD]


def publish(port: int, name: str, payload: bytes, *more: str) -> None:
    line = [need_program("mosquitto_pub", "mosquitto-clients"), "-V", "5", "-p", str(port), "-s", *more]
    subprocess.run([*line, "-t", f"altd/{SERIAL}/{name}"], input=payload, check=True)


def test_the_program_keeps_out_what_the_broker_has_retained(tmp_path: Path) -> None:
    words = [sys.executable, PROGRAM, "127.0.0.1"]
    with mosquitto(tmp_path, "allow_anonymous true") as (port, _):
        publish(port, "measurement", message(1, at=datetime.now(UTC), of=OTHER), "-r")
        with clients.running([*words, port, SERIAL, 30_000]) as (_, told):
            assert _first_after("no answer", told) == ("retained", None)
            publish(port, "measurement", message(2, at=datetime.now(UTC)))
            assert _first_after("no answer", told) == (GOOD, VALUES)
            assert next(told) == ("no answer", VALUES)
            publish(port, "availability", OFFLINE)
            assert _first_after("no answer", told) == ("offline", None)


def test_the_program_follows_a_unit_that_stops_and_restarts(played_unit: PlayedUnit, tmp_path: Path) -> None:
    with mosquitto(tmp_path, "allow_anonymous true") as (port, _):
        more = f'[mqtt]\nhost = "localhost"\nport = {port}\nevery_measurement = true\n'
        arguments = [sys.executable, PROGRAM, "127.0.0.1", port, "TEST-1", 3000]
        with (
            playing(played_unit, tmp_path, subprocess.DEVNULL, more=more) as daemon,
            clients.running([*arguments, "--rehearsal"]) as (_, told),
            clients.running(arguments) as (_, not_told),
        ):
            assert ("not live", None) in not_told
            assert next(verdict for verdict in told if verdict[0] == GOOD)[1] == TRUTH
            daemon.process.kill()
            daemon.process.wait()
            assert ("offline", None) in told
            with subprocess.Popen(daemon.process.args, stderr=subprocess.DEVNULL) as again:
                try:
                    assert ("restarted", None) in told
                finally:
                    again.kill()


@pytest.mark.waits
def test_a_broker_that_stands_still_lets_no_old_value_through(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """The values are of a recording, so the reader has no UTC to compare: only the clocks' advance.

    A further reader is acknowledged at each message, so that only the age of a value keeps it out.
    """
    limit_ms, still_s = 2000.0, 15.0
    heard: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTv5)
    client.on_connect = lambda *_: client.subscribe("altd/TEST-1/measurement")
    client.on_message = lambda _client, _data, it: heard.put((time.monotonic() * 1e3, it.payload))
    readers = [reader(limit_ms, True, zlib.crc32(b"TEST-1")) for _ in range(2)]
    seen: list[tuple[float, float, float, list[str]]] = []

    def read() -> list[str]:
        """The verdicts on the next message; ``seen`` has when it came, the unit's clock, and its age then."""
        now_ms, payload = heard.get(timeout=60)
        told = json.loads(payload)
        faults = [each.update(payload, False, now_ms, 0.0, bool(n)) for n, each in enumerate(readers)]
        seen.append((now_ms, told["clock_ms"], 1e3 * told["age_s"], faults))
        return faults

    with mosquitto(tmp_path, "allow_anonymous true") as (port, broker):
        more = f'[mqtt]\nhost = "127.0.0.1"\nport = {port}\nevery_measurement = true\n'
        with playing(played_unit, tmp_path, subprocess.DEVNULL, more=more):
            client.connect("127.0.0.1", port)
            client.loop_start()
            try:
                while read() != [GOOD, GOOD]:
                    pass
                for _ in range(20):
                    read()
                broker.send_signal(signal.SIGSTOP)
                time.sleep(still_s)
                broker.send_signal(signal.SIGCONT)
                again_ms = time.monotonic() * 1e3
                while read()[1] != GOOD or seen[-1][0] < again_ms:
                    pass
                for _ in range(20):
                    read()
            finally:
                broker.send_signal(signal.SIGCONT)
                client.loop_stop()
    started_ms = min(now_ms - clock_ms for now_ms, clock_ms, _, _ in seen)
    ages_ms = [now_ms - started_ms - clock_ms + age_ms for now_ms, clock_ms, age_ms, _ in seen]
    after = [
        (age_ms, faults)
        for age_ms, (now_ms, *_, faults) in zip(ages_ms, seen, strict=True)
        if now_ms >= again_ms
    ]
    first_good_ms = next(now_ms for now_ms, *_, faults in seen if now_ms >= again_ms and GOOD in faults)
    assert any(age_ms > 1e3 * still_s - limit_ms for age_ms, _ in after), "the broker held a message back"
    assert all(age_ms <= limit_ms for age_ms, faults in after if GOOD in faults)
    assert {faults[0] for _, faults in after} == {"silent"}, "until an operator acknowledges it"
    assert first_good_ms - again_ms < 5000


def _first_after(fault: str, told: Iterator[Verdict]) -> Verdict:
    return next(verdict for verdict in told if verdict[0] != fault)
