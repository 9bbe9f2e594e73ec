"""Three blocks, one request each: identity of the unit, its condition, and values relative to the zero."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from altd.publish.modbus import values
from altd.publish.modbus.registers import Register, Table, Type
from altd.publish.modbus.values import Reading
from altd.reasons import Reason
from altd.selfcheck.records import Verdict
from altd.status.availability import SPANS
from altd.status.health import MEASURING, ComponentReport
from altd.status.unit import UnitView

BLOCK_VERSION = 1
"""Version of these blocks; incremented when a register changes its meaning or address."""

VERDICTS = {Verdict.GOOD: 1, Verdict.SUSPECT: 2, Verdict.BAD: 3, Verdict.UNKNOWN: 4}
"""Numbers of a self-check's verdicts; 0: no check has ended since the start."""

THERMOMETERS = 4
"""Number of temperatures that have registers."""

TARGETS = ("front", "rear")
_DAY_S = 86_400


def _calibration(view: UnitView) -> datetime | None:
    created = view.calibration_identity.created
    return None if created is None else datetime.fromisoformat(created)


def _calibration_date(view: UnitView) -> int | None:
    created = _calibration(view)
    return None if created is None else int(f"{created:%Y%m%d}")


def _calibration_age_days(view: UnitView) -> float | None:
    created = _calibration(view)
    return None if created is None or view.utc is None else (view.utc - created).total_seconds() // _DAY_S


def _first_32_bits(digest: str | None) -> int | None:
    """First 32 bits of a hexadecimal digest; the name of the algorithm may precede it: ``sha256:89ab…``."""
    digits = (digest or "").rpartition(":")[2][:8]
    return int(digits, 16) if digits else None


def _is_rehearsal(view: UnitView) -> int | None:
    """Whether the unit rehearses; None before the first measurement, which carries the reason."""
    measurement = view.measurement
    return None if measurement is None else values.has(measurement, Reason.REHEARSAL)


_UNIT_ROWS = (
    Register(300, "block_version", Type.U16, "", "version of this block", values.constant(BLOCK_VERSION)),
    Register(301, "rehearsal", Type.U16, "", "1: started with `--rehearsal`; 0: not", _is_rehearsal),
    Register(302, "unit", Type.U32, "", "as at address 202", values.of_identity("unit")),
    Register(304, "session", Type.U32, "", "as at address 204", values.of_identity("session")),
    Register(306, "uptime", Type.U32, "s", "since the daemon started", values.uptime_s),
    Register(308, "calibration_date", Type.U32, "", "UTC: 2026-11-02 is 20261102", _calibration_date),
    Register(310, "calibration_age", Type.U16, "d", "age of the calibration", _calibration_age_days),
    Register(
        311,
        "operating_hours",
        Type.U16,
        "h",
        "operating hours of the unit over its life",
        lambda view: view.operating_hours,
    ),
    Register(
        312,
        "calibration_checksum",
        Type.U32,
        "",
        "first 32 bits of its checksum",
        lambda view: _first_32_bits(view.calibration_identity.checksum),
    ),
    Register(
        314,
        "config_checksum",
        Type.U32,
        "",
        "first 32 bits of the config's SHA-256",
        lambda view: _first_32_bits(view.facts.config_sha256),
    ),
    Register(
        316,
        "firmware",
        Type.TEXT16,
        "",
        "version of the daemon",
        lambda view: view.facts.version or None,
    ),
    Register(
        324,
        "serial",
        Type.TEXT32,
        "",
        "serial number, cut if longer",
        lambda view: view.facts.serial or None,
    ),
)


def _figure(component: ComponentReport | None, name: str) -> float | None:
    return component.figure(name) if component else None


def _of_camera(target: str, name: str) -> Reading:
    """A figure of the camera of a target."""

    def read(view: UnitView) -> float | None:
        cameras = (area.camera for area in view.targets if area.name == target)
        return _figure(view.component(f"camera {next(cameras, None)}"), name)

    return read


def _of_measuring(name: str) -> Reading:
    return lambda view: _figure(view.component(MEASURING), name)


def _lost_frames(view: UnitView) -> int:
    """Number of frames of all cameras that drivers lost or the daemon dropped."""
    lost = sum(
        component.counters.get("lost", 0) for component in view.components if component.kind == "camera"
    )
    measuring = view.component(MEASURING)
    counters = measuring.counters if measuring else {}
    return lost + sum(count for name, count in counters.items() if name.startswith("dropped_"))


def _late_frames(view: UnitView) -> int:
    measuring = view.component(MEASURING)
    return measuring.counters.get("late_frames", 0) if measuring else 0


def _temperature(number: int) -> Reading:
    """The temperature of thermometer ``number``, counted from 0."""

    def read(view: UnitView) -> float | None:
        known = [component for component in view.components if component.kind == "temperature"]
        return _figure(known[number], "celsius") if number < len(known) else None

    return read


def _verdict(view: UnitView) -> int | None:
    if view.self_check is None:
        return None if view.no_self_check else 0
    return VERDICTS[view.self_check.check.verdict]


def _check_age_s(view: UnitView) -> float | None:
    return None if view.self_check is None else (view.now_ns - view.self_check.ended_ns) * 1e-9


def _share(span: str) -> Reading:
    def read(view: UnitView) -> float | None:
        share = None if view.state is None else view.state.availability.shares().get(span)
        return None if share is None else 10_000 * share

    return read


def _roll_age_ms(view: UnitView) -> float | None:
    said = view.measurement and view.measurement.from_sensors.get("roll_deg")
    return (view.now_ns - said.t_ns) * 1e-6 if said and said.value is not None else None


def _condition_rows() -> Iterator[Register]:
    """Yield the registers in the order of their addresses."""
    version = values.constant(BLOCK_VERSION)
    yield Register(400, "block_version", Type.U16, "", "version of this block", version)
    yield Register(401, "state", Type.U16, "", values.STATE_MEANING, values.state)
    meaning = "0 none yet, " + ", ".join(f"{number} {verdict}" for verdict, number in VERDICTS.items())
    yield Register(402, "self_check", Type.U16, "", f"last verdict: {meaning}", _verdict)
    yield Register(404, "self_check_age", Type.U32, "s", "since that check ended", _check_age_s)
    for place, span in enumerate(SPANS):
        text = "share of time with a valid measurement"
        yield Register(406 + place, f"valid_{span}", Type.U16, "0.01 %", text, _share(span))
    text = "frames lost by drivers or daemon since the start"
    yield Register(410, "lost_frames", Type.U32, "", text, _lost_frames)
    text = "frames too late to be paired"
    yield Register(412, "late_frames", Type.U32, "", text, _late_frames)
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


def _zero_sequence(view: UnitView) -> int | None:
    zero = view.zero.measurement
    return None if zero is None else zero.sequence % 0xFFFF_FFFF


def _zero_age_s(view: UnitView) -> float | None:
    zero = view.zero.measurement
    return None if zero is None else (view.now_ns - zero.t_ns) * 1e-9


def _difference(key: str, is_sigma: bool) -> Reading:
    def read(view: UnitView) -> float | None:
        found = view.zero.difference(key, view.measurement)
        return (found.sigma if is_sigma else found.value) if found else None

    return read


def _relative_rows() -> Iterator[Register]:
    """Yield the registers in the order of their addresses."""
    version = values.constant(BLOCK_VERSION)
    yield Register(500, "block_version", Type.U16, "", "version of this block", version)
    text = "zeros set since the daemon started"
    yield Register(501, "zeros", Type.U16, "", text, lambda view: view.zero.count % 0xFFFF)
    text = "the value that sets the next zero"
    yield Register(502, "next_zero", Type.U16, "", text, lambda view: view.zero.next_number)
    yield Register(503, "status", Type.U16, "", "status word as at address 0", values.status)
    yield Register(504, "session", Type.U32, "", "as at address 204", values.of_identity("session"))
    yield Register(506, "sequence", Type.U32, "", "number of the last exposure averaged", values.sequence)
    text = "since the middle of the exposures"
    yield Register(508, "age", Type.U32, "ms", text, values.age_ms)
    yield Register(510, "zero_sequence", Type.U32, "", "`sequence` of the zero", _zero_sequence)
    text = "since the middle of the zero's exposures"
    yield Register(512, "zero_age", Type.U32, "s", text, _zero_age_s)
    row = 514
    for sigma, text in (("", "less that of the zero"), ("sigma_", "its standard deviation")):
        for name, unit, key in _RELATIVE_AXES:
            yield Register(row, sigma + name, Type.F32, unit, text, _difference(key, bool(sigma)))
            row += 2


UNIT = Table(_UNIT_ROWS, 300, 50)
RELATIVE = Table(tuple(_relative_rows()), 500, 30)
CONDITION = Table(tuple(_condition_rows()), 400, 60)
