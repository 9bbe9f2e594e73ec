"""The registers of a row: each place in its own block, what is not known as NaN, reasons and warnings."""

import math
import struct

from support.measurements import measured, measurement_of_row

from altd.publish.modbus.registers import FAR, NEAR, PER_PLACE, Table, image
from altd.publish.modbus.values import PLACE_WARNINGS, ROW_WARNINGS
from altd.reasons import Reason
from altd.records import Fault
from altd.status.unit import UnitView
from tools.pages.example import view_of

NAMES = ("t1", "t2", "t3")
MOVED_MM = {"t1": (0.0, 0.0), "t3": (0.32, -0.24)}


def words_of(place: int, words: list[int]) -> tuple[int, int, list[float]]:
    """Reason, warnings and values of a place of a table, counted from 1."""
    first = 10 + PER_PLACE * (place - 1)
    reason, warnings, *values = words[first : first + PER_PLACE]
    return reason, warnings, list(struct.unpack(">5f", struct.pack(">10H", *values)))


def test_a_place_has_its_displacement_sigma_and_significance() -> None:
    status = (
        Fault(Reason.BEAM_ANGLE_UNKNOWN),
        Fault(Reason.STUCK_CLEAR, "t2"),
        Fault(Reason.SPOT_MISSING, "t2"),
        Fault(Reason.ALARM_DISPLACEMENT, "t3"),
        Fault(Reason.STUCK_OPAQUE, "t3"),
    )
    words = image(view_of(measurement_of_row(NAMES, MOVED_MM, lost=("t2",), status=status), 4.25, 9), NEAR)
    assert words[0] == 1 | 1 << 15  # valid, and a reason of the group "not trusted"
    assert words[1:4] == [3, 42, 1 << ROW_WARNINGS.index(Reason.BEAM_ANGLE_UNKNOWN)]
    assert words[4:6] == [0, 139]
    reason, warnings, values = words_of(3, words)
    assert (reason, warnings) == (
        0,
        1 << PLACE_WARNINGS.index(Reason.ALARM_DISPLACEMENT) | 1 << PLACE_WARNINGS.index(Reason.STUCK_OPAQUE),
    )
    assert [round(value, 4) for value in values] == [0.32, -0.24, 0.004, 0.004, 7.5]
    reason, warnings, values = words_of(2, words)
    assert (reason, warnings) == (13, 0)
    assert all(map(math.isnan, values))


def test_places_beyond_the_row_and_another_instrument_say_nothing() -> None:
    measurement = measurement_of_row(NAMES, MOVED_MM)
    beyond = [(NEAR, place) for place in range(4, 9)] + [(FAR, place) for place in range(1, 9)]
    for table, place in beyond:
        reason, warnings, values = words_of(place, image(view_of(measurement, 1.0, 1), table))
        assert (reason, warnings) == (0xFFFF, 0xFFFF)
        assert all(map(math.isnan, values))
    of_beam = image(view_of(measured(), 1.0, 1), NEAR)
    assert of_beam[1] == of_beam[3] == 0xFFFF
    assert all(math.isnan(value) for value in words_of(1, of_beam)[2])


def test_the_ninth_place_is_the_first_of_the_second_table() -> None:
    names = [f"t{number}" for number in range(1, 17)]
    moved_mm = {name: (0.1 * number, -0.1 * number) for number, name in enumerate(names, start=1)}
    view = view_of(measurement_of_row(names, moved_mm), 1.0, 1)
    for table, first in ((NEAR, 1), (FAR, 9)):
        assert _displacements_mm(view, table) == [
            round(0.1 * number, 4) for number in range(first, first + 8)
        ]


def _displacements_mm(view: UnitView, table: Table) -> list[float]:
    words = image(view, table)
    return [round(words_of(place, words)[2][0], 4) for place in range(1, 9)]
