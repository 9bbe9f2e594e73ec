"""Registers of the beam's covariance and of points of the machine: as in the JSON, or NaN."""

import math
import struct
from dataclasses import replace

from altd.config import Installation, Machine
from altd.instruments.beam.instrument import quantities_of
from altd.instruments.beam.points import MachinePoints
from altd.publish.modbus.machine_blocks import JOINT, MACHINE, PER_POINT
from altd.publish.modbus.registers import image
from altd.records import Measurement
from altd.status.measurement_json import as_object, as_object_now
from altd.status.unit import UnitView
from tools.pages.example import AGE_S, MEASURED, view_of

POINTS = [
    {"name": f"p{number}", "x_mm": 0, "y_mm": 0, "z_mm": 1000 * number, "sigma_mm": 1} for number in (1, 2)
]
SETTINGS = Machine.model_validate(
    {"roll_deg": 1.0, "roll_sigma_deg": 0.0, "mount_sigma_deg": 0.0, "points": POINTS}
)
OF_MACHINE = quantities_of(Installation(), SETTINGS)
KNOWN = MachinePoints(SETTINGS, Installation()).finish(replace(MEASURED, quantities=OF_MACHINE))


def of_unit(measurement: Measurement | None) -> UnitView:
    return replace(view_of(measurement), quantities=OF_MACHINE)


def floats(words: list[int]) -> list[float]:
    return list(struct.unpack(f">{len(words) // 2}f", struct.pack(f">{len(words)}H", *words)))


def test_the_covariance_is_that_of_the_json() -> None:
    document, words = as_object_now(MEASURED, AGE_S), image(view_of(MEASURED), JOINT)
    assert words[2:4] == [0, MEASURED.sequence]
    values, mean, now = (floats(words[first:last]) for first, last in ((4, 12), (12, 32), (32, 52)))
    joint = [document[key] for key in MEASURED.quantities.joint]
    assert all(math.isclose(one, other, rel_tol=1e-4) for one, other in zip(values, joint, strict=True))
    for name, found in (("covariance", mean), ("covariance_now", now)):
        upper = [document[name][row][column] for row in range(4) for column in range(row, 4)]
        assert all(math.isclose(one, other, rel_tol=1e-5) for one, other in zip(found, upper, strict=True))


def test_points_are_those_of_the_json_and_others_are_not_known() -> None:
    words, of = image(of_unit(KNOWN), MACHINE), as_object(KNOWN)["points"]
    assert (words[0] & 1, words[1]) == (1, 2)
    for number, name in enumerate(("p1", "p2")):
        found = floats(words[4 + PER_POINT * number :][:PER_POINT])
        wanted = [of[name]["right_mm"], of[name]["up_mm"], *of[name]["sigma"].values()]
        assert all(math.isclose(one, other, abs_tol=1e-3) for one, other in zip(found, wanted, strict=False))
        assert found[4] > found[2] >= 1.0
    assert all(map(math.isnan, floats(words[4 + 2 * PER_POINT :])))


def test_an_invalid_measurement_has_neither() -> None:
    for measurement in (KNOWN.without_numbers(()), None):
        assert all(map(math.isnan, floats(image(of_unit(measurement), MACHINE)[4:])))
        assert all(map(math.isnan, floats(image(of_unit(measurement), JOINT)[4:])))
