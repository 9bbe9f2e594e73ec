"""Telegrams of a plate and of a row, read by a parser that knows the tables of docs/telegram.md alone."""

import zlib
from dataclasses import replace
from datetime import UTC, datetime
from functools import reduce
from operator import xor

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.clock import FakeClock
from support.measurements import measurement_of_row
from support.serving import lines, serving
from support.wire import Wire

from altd.config import TelegramPortSettings
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.publish.serial.plate_and_row import encode
from altd.publish.serial.publisher import TelegramPublisher
from altd.reasons import Reason
from altd.records import Fault, Measurement, Value
from altd.status.board import Board
from altd.status.health import Component
from tools.pages.example import NAMEPLATE

TIME = datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC)
NAMES = ("t1", "t1_b", "t3")
"""The second begins with the name of the first."""
PLATE = Measurement(
    160, 8_000_000_000, TIME, 20, OF_PLATE,
    {"a_mm": Value(12.3456, 0.004), "b_mm": Value(-701.25, 0.005), "phi_deg": Value(-179.99996, 0.0021)}, {},
)  # fmt: skip
STATUS = (Fault(Reason.BEAM_ANGLE_UNKNOWN), Fault(Reason.STUCK_CLEAR, "t1_b"), Fault(Reason.ALARM_RATE, "t3"))
ROUND = measurement_of_row(
    NAMES, {"t1": (0.0, -0.0), "t3": (0.3256, -12.5)}, lost=("t1_b",), status=STATUS, time=TIME
)
FIELDS = {
    "PALTP": "time mode sequence a_mm b_mm phi_deg",
    "PALTS": "sequence frames sigma_a_mm sigma_b_mm sigma_phi_deg reasons",
    "PALTR": "time mode sequence places measured reasons",
    "PALTD": "sequence number mode dx_mm dy_mm sigma_dx_mm sigma_dy_mm reasons",
}
NUMBERS = {"a_mm", "b_mm", "phi_deg", "sigma_a_mm", "sigma_b_mm", "sigma_phi_deg"}
NUMBERS |= {"dx_mm", "dy_mm", "sigma_dx_mm", "sigma_dy_mm"}


def parsed(telegram: bytes) -> list[dict[str, str]]:
    """The known fields of each sentence, by name; with the sentence's name."""
    found = []
    for line in telegram.decode("ascii").removesuffix("\r\n").split("\r\n"):
        assert len(line) + 2 <= 82
        body, _, checksum = line.removeprefix("$").partition("*")
        assert checksum == f"{reduce(xor, body.encode()):02X}" == f"{pynmea2.NMEASentence.checksum(body):02X}"
        name, *fields = body.split(",")
        named = zip(FIELDS[name].split(), fields, strict=True)
        found.append({"": name} | {key: field for key, field in named if field})
    return found


def test_a_pose_and_its_quality() -> None:
    assert parsed(encode(PLATE, OF_PLATE)) == [
        {"": "PALTP", "time": "081530.125", "mode": "A", "sequence": "160",
         "a_mm": "12.346", "b_mm": "-701.250", "phi_deg": "-180.0000"},
        {"": "PALTS", "sequence": "160", "frames": "20",
         "sigma_a_mm": "0.0040", "sigma_b_mm": "0.0050", "sigma_phi_deg": "0.0021"},
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("measurement", "mode", "reasons"),
    [
        (None, "V", "warming_up"),
        (PLATE.without_numbers((Fault(Reason.LEDS_MISSING),)), "V", "leds_missing"),
        (replace(PLATE, status=(Fault(Reason.SIMULATED),)), "S", "simulated"),
        (replace(PLATE, status=(Fault(Reason.PLAYBACK),)), "P", "playback"),
        (replace(PLATE, values=dict(PLATE.values) | {"a_mm": Value(1e4, 0.1)}), "V", "does_not_fit"),
        (
            replace(PLATE, values=dict(PLATE.values) | {"phi_deg": Value(float("nan"), 0.1)}),
            "V",
            "does_not_fit",
        ),
    ],
)
def test_a_pose_that_is_not_to_be_used(measurement: Measurement | None, mode: str, reasons: str) -> None:
    pose, quality = parsed(encode(measurement, OF_PLATE))
    assert (pose["mode"], quality["reasons"]) == (mode, reasons)
    assert mode != "V" or not (pose.keys() | quality.keys()) & NUMBERS


def test_each_place_of_a_round_has_its_own_mode_and_reasons() -> None:
    assert parsed(encode(ROUND, ROUND.quantities)) == [
        {"": "PALTR", "time": "081530.125", "mode": "A", "sequence": "139", "places": "3", "measured": "2",
         "reasons": "beam_angle_unknown"},
        {"": "PALTD", "sequence": "139", "number": "1", "mode": "A", "dx_mm": "0.000", "dy_mm": "0.000",
         "sigma_dx_mm": "0.0040", "sigma_dy_mm": "0.0040"},
        {"": "PALTD", "sequence": "139", "number": "2", "mode": "V", "reasons": "stuck_clear"},
        {"": "PALTD", "sequence": "139", "number": "3", "mode": "A", "dx_mm": "0.326", "dy_mm": "-12.500",
         "sigma_dx_mm": "0.0040", "sigma_dy_mm": "0.0040", "reasons": "alarm_rate"},
    ]  # fmt: skip


def test_before_the_baseline_a_measured_round_has_no_displacement() -> None:
    head, *places = parsed(encode(measurement_of_row(NAMES), ROUND.quantities))
    assert (head["mode"], head["measured"]) == ("A", "3")
    assert [place["mode"] for place in places] == ["V"] * 3


def test_before_the_first_round_each_place_is_invalid() -> None:
    head, *places = parsed(encode(None, ROUND.quantities))
    assert head == {"": "PALTR", "mode": "V", "places": "3", "reasons": "warming_up"}
    assert [(place["number"], place["mode"]) for place in places] == [("1", "V"), ("2", "V"), ("3", "V")]


any_mm = st.none() | st.floats(allow_nan=True, allow_infinity=True) | st.floats(-20, 20)
any_sigma = st.none() | st.floats() | st.floats(1e-4, 1.0)
any_status = st.lists(
    st.builds(Fault, st.sampled_from(list(Reason)), st.sampled_from([None, *NAMES])), max_size=12
)


@given(st.lists(st.tuples(any_mm, any_sigma), min_size=6, max_size=6), any_status, st.integers(0, 2**40))
def test_whatever_is_measured_what_is_invalid_has_no_numbers_and_what_is_valid_has_all(
    drawn: list[tuple[float | None, float | None]], status: list[Fault], sequence: int
) -> None:
    keys = [f"{name}_d{axis}_mm" for name in NAMES for axis in "xy"]
    values = {key: Value(mm, sigma) for key, (mm, sigma) in zip(keys, drawn, strict=True) if mm is not None}
    if values:
        values["measured"] = Value(1.0)
    made = replace(ROUND, values=values, status=tuple(status), sequence=sequence)
    head, *places = parsed(encode(made, ROUND.quantities))
    assert (head["mode"] == "V") is not made.valid
    for place, of_place in zip(places, zip(drawn[::2], drawn[1::2], strict=True), strict=True):
        assert place["sequence"] == head["sequence"] == str(sequence % 2**32)
        if place["mode"] == "V":
            assert not place.keys() & NUMBERS
        else:
            assert place["mode"] == head["mode"]
            for axis, (mm, sigma) in zip("xy", of_place, strict=True):
                assert float(place[f"d{axis}_mm"]) == pytest.approx(mm, abs=0.0005001)
                assert float(place[f"sigma_d{axis}_mm"]) == pytest.approx(sigma, abs=0.00005001)


async def test_a_row_of_sixteen_goes_through_the_port_in_one_piece_with_its_proof(
    wire: Wire, component: Component, clock: FakeClock
) -> None:
    names = [f"t{number}" for number in range(1, 17)]
    made = measurement_of_row(names, dict.fromkeys(names, (-1234.5678, -1234.5678)), time=TIME)
    made = replace(made, sequence=2**32 - 1, status=tuple(Fault(Reason.ALARM_RATE, name) for name in names))
    board = Board(clock, 10.0, made.quantities)
    board.publish(made)
    port = TelegramPortSettings(
        device=wire.device, speaks="telegram", interval_s=5.0, checked=True, identify_every_s=60.0
    )
    async with serving(TelegramPublisher(port, board, component, clock, NAMEPLATE)):
        received = (await wire.receive(lines(20))).removeprefix(b"\r\n")
    before, _, last = received.rpartition(b"$PALTI")
    telegram = before.splitlines(keepends=True)
    assert last
    assert [line[1:6] for line in telegram] == [b"PALTR", *[b"PALTD"] * 16, b"PALTC"]
    assert [place["dx_mm"] for place in parsed(b"".join(telegram[1:17]))] == ["-1234.568"] * 16
    covered, _, crc = before.rpartition(b",")
    assert crc[:8] == b"%08X" % zlib.crc32(covered + b",")
    assert component.counters == {"telegrams_sent": 1}
