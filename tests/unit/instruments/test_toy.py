"""A toy instrument with quantities of its own: chain, gate, JSON, console, page, tables take it as it is."""

import json
import math
import re
from dataclasses import dataclass, replace

import pytest
from support import evidence
from support.clock import FakeClock
from support.located import located, paired

from altd.config import Measuring
from altd.files.documents import line_of
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.gate import Gate
from altd.measuring.instrument import Solution
from altd.publish.http.answers import page_of
from altd.publish.serial.words import measurement_text, watch_head, watch_line
from altd.reasons import Reason
from altd.records import Fault, MeanSpots, Measurement, Quantities, Quantity, Spot, Value
from altd.status.board import Board
from altd.status.measurement_json import as_object
from altd.tables import measurement_columns

QUANTITIES = Quantities(
    "toy",
    (
        Quantity("along_px", "along", "px", "how far the spot lies to the right", 2),
        Quantity("heat_deg", "heat", "°", "known at times", 3, has_sigma=False, is_optional=True),
    ),
    (Quantity("v_px", "v", "px", "the height in the picture of", 1, has_sigma=False),),
)


@dataclass
class Toy:
    """Gives the place of its one target's spot."""

    limit_px: float = 300.0
    quantities = QUANTITIES
    min_targets = 1

    def solve(self, mean: MeanSpots) -> Solution | Fault:
        (u_px, v_px) = map(float, mean.px[0])
        if u_px > self.limit_px:
            return Fault(Reason.OUT_OF_RANGE, detail="too far to the right")
        sigma_px = math.sqrt(mean.covariance_px2[0, 0])
        return Solution({"along_px": Value(u_px, sigma_px)}, {mean.targets[0]: {"v_px": Value(v_px)}})


def measured(calibration: Calibration, u_px: float, toy: Toy | None = None) -> Measurement:
    """The chain's measurement of a window of a spot at rest, on one target alone."""
    chain = MeasuringChain((View("front", "camera"),), calibration, Measuring(window=4), toy or Toy())
    measurements: list[Measurement] = []
    for sequence in range(4):
        spot = Spot(u_px, 120.0, 0.05, 40.0, 200.0)
        one = replace(located("camera", sequence, sequence * 50_000_000), spot=spot)
        measurement = chain.add(paired(one))
        measurements += [measurement] if measurement else []
    return measurements[-1]


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return measured(evidence.calibration(), 250.125)


def test_the_chain_measures_its_quantities(measurement: Measurement) -> None:
    assert measurement.valid
    assert measurement.number("along_px") == pytest.approx(250.125)
    assert measurement.sigma("along_px") is not None
    assert measurement.number("heat_deg") is None


def test_why_it_does_not_solve_a_window_is_published() -> None:
    refused = measured(evidence.calibration(), 301.0)
    assert (refused.valid, refused.status[0].detail) == (False, "too far to the right")
    assert json.loads(line_of(as_object(refused)))["along_px"] is None


def test_json_has_its_keys_with_its_decimals_and_no_other(measurement: Measurement) -> None:
    document = json.loads(
        line_of(as_object(replace(measurement, values=measurement.values | {"heat_deg": Value(20.00049)})))
    )
    own = set(document) - {"sequence", "time", "t_s", "frames", "valid", "status"}
    assert own == {"along_px", "heat_deg", "sigma", "sigma_random", "front"}
    assert (document["along_px"], document["heat_deg"], document["front"]) == (250.12, 20.0, {"v_px": 120.0})
    assert document["sigma"].keys() == document["sigma_random"].keys() == {"along_px"}


def test_the_console_writes_a_line_a_quantity(measurement: Measurement) -> None:
    assert "  along       250.1 px  +/- 0.0\n  heat      not available" in measurement_text(measurement)
    assert watch_head(QUANTITIES).split() == ["time", "(UTC)", "along", "px"]
    assert watch_line(measurement).split()[1] == "250.1"


def test_the_page_has_a_row_for_what_is_always_there() -> None:
    page = page_of(Board(FakeClock(), 1.0, QUANTITIES).quantities)
    facts = re.search(r'<script type="application/json" id="quantities">(.*)</script>', page)
    assert [
        (each["key"], each["label"], each["unit"], each["decimals"], each["is_shown"])
        for each in json.loads(facts[1])
    ] == [("along_px", "along", "px", 1, True), ("heat_deg", "heat", "°", 2, False)]


def test_tables_have_its_columns() -> None:
    columns = measurement_columns(QUANTITIES, ("front",), of_scan=False)
    own = [(column.name, column.unit, column.meaning) for column in columns[6:]]
    assert own == [
        ("along_px", "px", "how far the spot lies to the right"),
        ("heat_deg", "°", "known at times"),
        ("sigma_along_px", "px", "combined standard uncertainty"),
        ("sigma_random_along_px", "px", "the part of sigma that scatters"),
        ("front_v_px", "px", "the height in the picture of front"),
    ]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, "no quantity is known"),
        ({"heat_deg": Value(1.0)}, "along_px is not known"),
        ({"along_px": Value(math.nan, 0.1)}, "along_px is nan"),
        ({"along_px": Value(1.0)}, "sigma_along_px is not known"),
        ({"along_px": Value(1.0, 0.0)}, "sigma_along_px is 0"),
        ({"along_px": Value(1.0, math.inf)}, "sigma_along_px is inf"),
        ({"along_px": Value(1.0, 0.1), "heat_deg": Value(math.inf)}, "heat_deg is inf"),
    ],
)
def test_the_gate_lets_nothing_through_that_lacks_one_of_them(
    measurement: Measurement, values: dict[str, Value], said: str
) -> None:
    through = Gate().admit(replace(measurement, values=values))
    assert not through.valid
    assert (through.status[0].reason, through.status[0].detail) == (Reason.CHECK_FAILED, said)
