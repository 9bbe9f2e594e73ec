"""``altd refraction`` against published figures and a traced ray; ``altd registers`` and ``altd devices``."""

import csv
import json
import math
import re

import numpy as np
import pytest
from support.cli import altd_here, refusal

from altd.cli.main import main
from altd.cli.refraction import bending, index_per_kelvin, refractivity
from altd.publish.modbus.responder import TABLES
from altd.reasons import Reason
from altd.records import FloatArray


def edlen(wavelength_um: float, temperature_c: float, pressure_hpa: float) -> float:
    """n − 1 of dry air by Edlén, Metrologia 2, 1966, 71–80: dispersion and density in torr and °C."""
    wave = 1 / wavelength_um**2
    standard = 8342.13 + 2406030 / (130 - wave) + 15997 / (38.9 - wave)
    torr = pressure_hpa * 760 / 1013.25
    density = 1 + torr * (0.817 - 0.0133 * temperature_c) * 1e-6
    return 1e-8 * standard * torr * density / (1 + 0.0036610 * temperature_c) / 720.775


@pytest.mark.parametrize(
    ("temperature_c", "pressure_hpa"), [(-10, 1013.25), (20, 1013.25), (45, 900), (20, 1100)]
)
def test_refractivity_and_its_slope_agree_with_edlen(temperature_c: float, pressure_hpa: float) -> None:
    known = edlen(0.65, temperature_c, pressure_hpa)
    assert refractivity(temperature_c, pressure_hpa) == pytest.approx(known, rel=1e-3)
    slope = (edlen(0.65, temperature_c + 1, pressure_hpa) - edlen(0.65, temperature_c - 1, pressure_hpa)) / 2
    assert index_per_kelvin(temperature_c, pressure_hpa) == pytest.approx(slope, rel=0.01)


def test_published_figures_of_air_are_met() -> None:
    """NIST, Engineering Metrology Toolbox: n = 1 + 7.86e-4 p/(273 + t), p in kPa, at 633 nm; Ciddor 1996,
    table 1: 1.00027653 at 633 nm, 15 °C, 101.325 kPa, dry. Red light of 650 nm has 0.07 % less."""
    assert refractivity(20, 1013.25) == pytest.approx(7.86e-4 * 101.325 / 293, rel=2e-3)
    assert refractivity(15, 1013.25) == pytest.approx(2.7653e-4, rel=1e-3)


@pytest.mark.parametrize(("gradient", "distance_m"), [(1.0, 100.0), (0.2, 250.0), (3.0, 25.0)])
def test_a_ray_through_thin_layers_of_air_is_bent_as_much(gradient: float, distance_m: float) -> None:
    """In a layered medium n cos(angle to the layers) is constant (Snell): no curvature is assumed."""
    n0 = 1 + edlen(0.65, 20.0, 1013.25)

    def slope(x: FloatArray) -> FloatArray:
        excess = (n0 - 1) * gradient * x / (293.15 - gradient * x)  # n - n0, it sets out along its layer
        tangent: FloatArray = np.sqrt(excess * (2 * n0 + excess)) / n0
        return tangent

    root = np.linspace(
        0.0, 0.3, 30_001
    )  # dx/slope has a pole at x = 0, none when x is the square of something
    middle = (root[1:] + root[:-1]) / 2
    along = np.concatenate([[0.0], np.cumsum(np.diff(root) * 2 * middle / slope(middle**2))])
    x = float(np.interp(distance_m, along, root)) ** 2
    bent = bending(abs(index_per_kelvin(20.0, 1013.25)) * gradient, distance_m)
    assert bent.deviation_mm == pytest.approx(1000 * x, rel=2e-3)
    assert bent.angle_deg == pytest.approx(math.degrees(math.atan(float(slope(np.array(x))))), rel=2e-3)


def test_the_table_has_a_line_for_each_distance_and_what_it_is_not_for() -> None:
    lines = altd_here("refraction", "--gradient", "1", "--distance", "50", "100").out.splitlines()
    per_kelvin = (edlen(0.65, 19.5, 1013.25) - edlen(0.65, 20.5, 1013.25)) / 1.0
    for line, distance_m in zip(lines[4:6], (50, 100), strict=True):
        wanted = (distance_m, 500 * per_kelvin * distance_m**2, 1000 * per_kelvin * distance_m)
        assert [float(word) for word in line.split()[:3]] == pytest.approx(wanted, rel=0.01)
    assert float(lines[5].split()[1]) == pytest.approx(5, abs=0.5)
    assert lines[-1] == "The beam bends towards the colder air. altd does not correct this."


@pytest.mark.parametrize("wrong", [("--pressure", "100"), ("--distance", "nan"), ("--gradient", "x")])
def test_a_wrong_argument_is_one_line(wrong: tuple[str, str]) -> None:
    said = refusal(altd_here("refraction", *wrong))
    assert said.startswith(f"altd refraction: {wrong[0]}: '{wrong[1]}' is not a number from ")


ROWS = [row for table in TABLES for row in table.rows]


def test_json_has_every_register_and_code() -> None:
    table = json.loads(altd_here("registers").out)
    assert [(row["address"], row["name"], row["type"]) for row in table["registers"]] == [
        (row.address, row.name, row.type) for row in ROWS
    ]
    x = next(row for row in table["registers"] if row["address"] == 60)
    assert (x["block"], x["name"], x["scale"], x["unit"], x["registers"]) == ("scaled", "x", 0.0001, "mm", 2)
    assert table["reasons"]["29"] == "not_live"
    assert table["status_bits"]["0"] == "valid"
    assert table["commands"] == {"1000": "self_check", "1001": "zero"}
    assert [row["name"] for row in table["discrete_inputs"]][:2] == ["valid", "failure"]


def test_csv_has_the_same() -> None:
    rows = list(csv.DictReader(altd_here("registers", "--format", "csv").out.splitlines()))
    assert [(int(row["address"]), row["name"]) for row in rows] == [(row.address, row.name) for row in ROWS]
    assert next(row for row in rows if row["name"] == "yaw")["unit"] == "°"


def test_structured_text_has_a_constant_for_each_and_no_name_twice() -> None:
    first, *lines, last = altd_here("registers", "--format", "st").out.splitlines()
    assert (first, last) == ("VAR_GLOBAL CONSTANT", "END_VAR")
    constant = re.compile(r"    (ALT_[A-Z0-9_]+) : UINT := (\d+);( \(\* [^*]+ \*\))?")
    found = [constant.fullmatch(line) for line in lines]
    assert all(found)
    names = [match[1] for match in found if match]
    assert len(set(names)) == len(names)
    assert "    ALT_CHECKED_STATUS : UINT := 220; (* UINT, status word as at address 0 *)" in lines
    assert f"    ALT_REASONS_STALE : UINT := {Reason.STALE.modbus_code};" in lines


def test_what_is_not_there_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("altd.devices.gpio.find_chips.chip_paths", list)
    assert main(["devices"]) == 0
    sections = [part.splitlines() for part in capsys.readouterr().out.split("\n\n")]
    assert ["GPIO chips: [lamps], [indicators]", "  none"] in sections
    assert len(sections) == 4
