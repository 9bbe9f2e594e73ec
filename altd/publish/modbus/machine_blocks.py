"""Two blocks for points of the machine (docs/machine.md): the beam with its covariance, and the points."""

from __future__ import annotations

from altd.publish.modbus import values
from altd.publish.modbus.registers import Register, Table, Type, in_pairs
from altd.publish.modbus.values import Reading
from altd.records.measurement import UNITS_OF_PRODUCTS
from altd.status.unit import UnitView

POINTS_AT_ONCE, PER_POINT = 8, 12
"""Number of points of the machine in the table, and of registers per point."""


def _covariance(row: int, column: int, is_now: bool) -> Reading:
    """A covariance of two of ``Quantities.joint``; ``is_now``: about the beam at the time of reading."""

    def value(view: UnitView) -> float | None:
        measurement, age_s = view.measurement, view.age_s
        if measurement is None or (is_now and age_s is None) or not measurement.quantities.joint:
            return None
        known = measurement.covariance(age_s if is_now else None)
        return None if known is None else float(known[row, column])

    return value


_READ = {"": values.number, "sigma_": values.sigma, "sigma_now_": values.sigma_now}


def _points(view: UnitView) -> int:
    """Number of points of the machine."""
    return sum(bool(each.point) for each in view.quantities.of_unit) // 2


def _point(number: int, axis: str, part: str) -> Reading:
    """Distance of a point of the machine, counted from 1, or its sigma, as the prefix ``part`` says."""

    def value(view: UnitView) -> float | None:
        keys = [
            each.key for each in view.quantities.of_unit if each.point and each.key.endswith(f"_{axis}_mm")
        ]
        if number > len(keys):
            return None
        found = _READ[part](keys[number - 1])(view)
        return found if isinstance(found, float) else None

    return value


_OF_JOINT = ("x", "y", "yaw_slope", "pitch_slope")


def _joint_table(first: int) -> Table:
    rows = [
        Register(first, "joint_status", Type.U16, "", "as `status`", values.status),
        Register(first + 2, "joint_sequence", Type.U32, "", "number of the last exposure", values.sequence),
        *(point.register(at, Type.F32) for at, point in in_pairs(first + 4, " ".join(_OF_JOINT))),
    ]
    for prefix, about, is_now in (
        ("cov", "covariance of the two values", False),
        ("cov_now", "the same as a statement about the beam when answered", True),
    ):
        for row, one in enumerate(_OF_JOINT):
            for column, other in enumerate(_OF_JOINT[row:], row):
                at, name = rows[-1].address + 2, f"{prefix}_{one}_{other}"
                unit = UNITS_OF_PRODUCTS[name.count("slope")]
                reading = _covariance(row, column, is_now)
                rows.append(Register(at, name, Type.F32, unit, about, reading, is_now))
    return Table(rows, first, rows[-1].address + 2 - first)


JOINT = _joint_table(850)
"""The line of a beam, and the covariance of its four numbers: row by row, from the diagonal on."""


def _point_table(first: int) -> Table:
    rows = [
        Register(first, "points_status", Type.U16, "", "as `status`", values.status),
        Register(first + 1, "points", Type.U16, "", "number of points", _points),
        Register(first + 2, "points_sequence", Type.U32, "", "number of the last exposure", values.sequence),
    ]
    for number in range(1, POINTS_AT_ONCE + 1):
        for part, about in (
            ("", "distance of the point from the beam"),
            ("sigma_", "combined standard uncertainty"),
            ("sigma_now_", "the same as a statement about the truth when answered"),
        ):
            for axis in ("right", "up"):
                at, reading = rows[-1].address + 2, _point(number, axis, part)
                name = f"point{number}_{part}{axis}"
                rows.append(Register(at, name, Type.F32, "mm", about, reading, part == "sigma_now_"))
    return Table(rows, first, rows[-1].address + 2 - first)


MACHINE = _point_table(1100)
"""Points of the machine, in the order of the settings."""
