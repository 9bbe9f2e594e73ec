"""Three blocks, one request each: identity of the unit, its condition, and values relative to the zero."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any

from altd.publish.modbus import values
from altd.publish.modbus.registers import Register, Table, Type
from altd.publish.modbus.values import Reading, Snapshot
from altd.reasons import Reason
from altd.selfcheck.records import Verdict
from altd.status.availability import SPANS
from altd.status.health import MEASURING, Component, Health

BLOCK_VERSION = 1
"""Version of these blocks; incremented when a register changes its meaning or address."""

VERDICTS = {Verdict.GOOD: 1, Verdict.SUSPECT: 2, Verdict.BAD: 3, Verdict.UNKNOWN: 4}
"""Numbers of a self-check's verdicts; 0: no check has ended since the start."""

THERMOMETERS = 4
"""Number of temperatures that have registers."""

TARGETS = ("front", "rear")
_DAY_S = 86_400


def _of_health(read: Callable[[Health], Any]) -> Reading:
    return lambda snapshot: read(snapshot.health) if snapshot.health else None


def _calibration(health: Health) -> datetime | None:
    created = health.calibration.identity.created
    return None if created is None else datetime.fromisoformat(created)


def _calibration_date(health: Health) -> int | None:
    created = _calibration(health)
    return None if created is None else int(f"{created:%Y%m%d}")


def _calibration_age_days(health: Health) -> float | None:
    created, now = _calibration(health), health.clock.utc(health.clock.monotonic_ns())
    return None if created is None or now is None else (now - created).total_seconds() // _DAY_S


def _first_32_bits(digest: str | None) -> int | None:
    """First 32 bits of a hexadecimal digest; the name of the algorithm may precede it: ``sha256:89ab…``."""
    digits = (digest or "").rpartition(":")[2][:8]
    return int(digits, 16) if digits else None


def _is_rehearsal(snapshot: Snapshot) -> int | None:
    """Whether the unit rehearses; None before the first measurement, which carries the reason."""
    measurement = snapshot.measurement
    return None if measurement is None else values.has(measurement, Reason.REHEARSAL)


_UNIT_ROWS = (
    Register(300, "block_version", Type.U16, "", "version of this block", values.constant(BLOCK_VERSION)),
    Register(301, "rehearsal", Type.U16, "", "1: started with `--rehearsal`; 0: not", _is_rehearsal),
    Register(302, "unit", Type.U32, "", "as at address 202", values.of_identity("unit")),
    Register(304, "session", Type.U32, "", "as at address 204", values.of_identity("session")),
    Register(306, "uptime", Type.U32, "s", "since the daemon started", values.uptime_s),
    Register(
        308, "calibration_date", Type.U32, "", "UTC: 2026-11-02 is 20261102", _of_health(_calibration_date)
    ),
    Register(
        310, "calibration_age", Type.U16, "d", "age of the calibration", _of_health(_calibration_age_days)
    ),
    Register(
        312,
        "calibration_checksum",
        Type.U32,
        "",
        "first 32 bits of its checksum",
        _of_health(lambda health: _first_32_bits(health.calibration.identity.checksum)),
    ),
    Register(
        314,
        "config_checksum",
        Type.U32,
        "",
        "first 32 bits of the config's SHA-256",
        _of_health(lambda health: _first_32_bits(health.facts.config_sha256)),
    ),
    Register(
        316,
        "firmware",
        Type.TEXT16,
        "",
        "version of the daemon",
        _of_health(lambda health: health.facts.version or None),
    ),
    Register(
        324,
        "serial",
        Type.TEXT32,
        "",
        "serial number, cut if longer",
        _of_health(lambda health: health.facts.serial or None),
    ),
)


def _component(health: Health, name: str) -> Component | None:
    return next((component for component in health if component.name == name), None)


def _figure(component: Component | None, name: str) -> float | None:
    value = component.figures.get(name) if component else None
    return value if isinstance(value, (int, float)) else None


def _of_camera(target: str, name: str) -> Reading:
    """A figure of the camera of a target."""

    def read(health: Health) -> float | None:
        cameras = (area.camera for area in health.targets if area.name == target)
        return _figure(_component(health, f"camera {next(cameras, None)}"), name)

    return _of_health(read)


def _of_measuring(name: str) -> Reading:
    return _of_health(lambda health: _figure(_component(health, MEASURING), name))


def _lost_frames(health: Health) -> int:
    """Number of frames of all cameras that drivers lost or the daemon dropped."""
    lost = sum(component.counters.get("lost", 0) for component in health if component.kind == "camera")
    measuring = _component(health, MEASURING)
    counters = measuring.counters if measuring else {}
    return lost + sum(count for name, count in counters.items() if name.startswith("dropped_"))


def _late_frames(health: Health) -> int:
    measuring = _component(health, MEASURING)
    return measuring.counters.get("late_frames", 0) if measuring else 0


def _temperature(number: int) -> Reading:
    """The temperature of thermometer ``number``, counted from 0."""

    def read(health: Health) -> float | None:
        known = [component for component in health if component.kind == "temperature"]
        return _figure(known[number], "celsius") if number < len(known) else None

    return _of_health(read)


def _verdict(health: Health) -> int | None:
    service = health.self_check
    if service.latest is None:
        return None if service.unavailable else 0
    return VERDICTS[service.latest.check.verdict]


def _check_age_s(health: Health) -> float | None:
    ended_ns = health.self_check.ended_ns
    return None if ended_ns is None else (health.clock.monotonic_ns() - ended_ns) * 1e-9


def _share(span: str) -> Reading:
    def read(snapshot: Snapshot) -> float | None:
        share = snapshot.shares.get(span)
        return None if share is None else 10_000 * share

    return read


def _roll_age_ms(snapshot: Snapshot) -> float | None:
    said = snapshot.measurement and snapshot.measurement.from_sensors.get("roll_deg")
    if not said or said.value is None or snapshot.health is None:
        return None
    return (snapshot.health.clock.monotonic_ns() - said.t_ns) * 1e-6


def _condition_rows() -> Iterator[Register]:
    """Yield the registers in the order of their addresses."""
    version = values.constant(BLOCK_VERSION)
    yield Register(400, "block_version", Type.U16, "", "version of this block", version)
    yield Register(401, "state", Type.U16, "", values.STATE_MEANING, values.state)
    meaning = "0 none yet, " + ", ".join(f"{number} {verdict}" for verdict, number in VERDICTS.items())
    yield Register(402, "self_check", Type.U16, "", f"last verdict: {meaning}", _of_health(_verdict))
    yield Register(404, "self_check_age", Type.U32, "s", "since that check ended", _of_health(_check_age_s))
    for place, span in enumerate(SPANS):
        text = "share of time with a valid measurement"
        yield Register(406 + place, f"valid_{span}", Type.U16, "0.01 %", text, _share(span))
    text = "frames lost by drivers or daemon since the start"
    yield Register(410, "lost_frames", Type.U32, "", text, _of_health(_lost_frames))
    text = "frames too late to be paired"
    yield Register(412, "late_frames", Type.U32, "", text, _of_health(_late_frames))
    row = 414
    for target in TARGETS:
        for name, unit, text, reading in (
            ("exposure", "ms", "of the camera", _of_camera(target, "exposure_ms")),
            ("gain", "dB", "of the camera", _of_camera(target, "gain_db")),
            ("diameter", "px", "1/e² diameter of the newest spot", _of_measuring(f"diameter_{target}_px")),
            ("peak", "", "counts over background of the newest spot", _of_measuring(f"peak_{target}")),
        ):
            yield Register(row, f"{target}_{name}", Type.F32, unit, text, reading)
            row += 2
    for number in range(THERMOMETERS):
        text = "in the order of /api/status"
        yield Register(row, f"temperature_{1 + number}", Type.F32, "°C", text, _temperature(number))
        row += 2
    text = "from an inclinometer; not known without one"
    yield Register(row, "roll", Type.F32, "°", text, values.number("roll_deg"))
    yield Register(
        row + 2, "sigma_roll", Type.F32, "°", "standard deviation of roll", values.sigma("roll_deg")
    )
    yield Register(row + 4, "roll_age", Type.U16, "ms", "of roll", _roll_age_ms)


_RELATIVE_AXES = (
    ("dx", "mm", "x_mm"),
    ("dy", "mm", "y_mm"),
    ("dyaw", "°", "yaw_deg"),
    ("dpitch", "°", "pitch_deg"),
)


def _zero_sequence(health: Health) -> int | None:
    zero = health.zero.measurement
    return None if zero is None else zero.sequence % 0xFFFF_FFFF


def _zero_age_s(health: Health) -> float | None:
    zero = health.zero.measurement
    return None if zero is None else (health.clock.monotonic_ns() - zero.t_ns) * 1e-9


def _difference(key: str, is_sigma: bool) -> Reading:
    def read(snapshot: Snapshot) -> float | None:
        found = snapshot.health and snapshot.health.zero.difference(key, snapshot.measurement)
        return (found.sigma if is_sigma else found.value) if found else None

    return read


def _relative_rows() -> Iterator[Register]:
    """Yield the registers in the order of their addresses."""
    version = values.constant(BLOCK_VERSION)
    yield Register(500, "block_version", Type.U16, "", "version of this block", version)
    text = "zeros set since the daemon started"
    yield Register(501, "zeros", Type.U16, "", text, _of_health(lambda health: health.zero.count % 0xFFFF))
    text = "the value that sets the next zero"
    yield Register(502, "next_zero", Type.U16, "", text, _of_health(lambda health: health.zero.next_number))
    yield Register(503, "status", Type.U16, "", "status word as at address 0", values.status)
    yield Register(504, "session", Type.U32, "", "as at address 204", values.of_identity("session"))
    yield Register(506, "sequence", Type.U32, "", "number of the last exposure averaged", values.sequence)
    text = "since the middle of the exposures"
    yield Register(508, "age", Type.U32, "ms", text, values.age_ms)
    yield Register(510, "zero_sequence", Type.U32, "", "`sequence` of the zero", _of_health(_zero_sequence))
    text = "since the middle of the zero's exposures"
    yield Register(512, "zero_age", Type.U32, "s", text, _of_health(_zero_age_s))
    row = 514
    for sigma, text in (("", "less that of the zero"), ("sigma_", "its standard deviation")):
        for name, unit, key in _RELATIVE_AXES:
            yield Register(row, sigma + name, Type.F32, unit, text, _difference(key, bool(sigma)))
            row += 2


UNIT = Table(_UNIT_ROWS, 300, 50)
RELATIVE = Table(tuple(_relative_rows()), 500, 30)
CONDITION = Table(tuple(_condition_rows()), 400, 60)
