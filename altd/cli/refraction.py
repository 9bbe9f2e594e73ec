"""``altd refraction``: the bending of a beam by a temperature gradient in the air of a tunnel.

The refractivity of air is proportional to its density, n − 1 = K p/T; at constant pressure
dn/dT = −(n − 1)/T. K is that of Ciddor's equation (Applied Optics 35, 1996, 1566–1573) for dry air at 650 nm,
15 °C, 1013.25 hPa. Across a gradient G the curvature of a beam is |dn/dT| G (Born and Wolf, Principles of
Optics, 3.2), here taken as constant along it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

from altd.process.standard_streams import print_lines

SUMMARY = "print how far a temperature gradient in the tunnel bends the beam"

_REFRACTIVITY_K_PER_HPA = 7.858e-5
_ZERO_CELSIUS_K = 273.15
_ROW = "{:>10}  {:>12}  {:>10}  {:>9}"


@dataclass(frozen=True, slots=True)
class Bending:
    """Deviation of a beam from its first direction after a distance, and its angle to it there."""

    deviation_mm: float
    angle_deg: float

    @property
    def angle_mm_per_m(self) -> float:
        """The angle as a slope, mm/m."""
        return 1000 * math.tan(math.radians(self.angle_deg))


def refractivity(temperature_c: float, pressure_hpa: float) -> float:
    """Index minus 1 of dry air at 650 nm. Water vapour lowers it by 5e-7 at 20 °C and 60 % humidity."""
    return _REFRACTIVITY_K_PER_HPA * pressure_hpa / (_ZERO_CELSIUS_K + temperature_c)


def index_per_kelvin(temperature_c: float, pressure_hpa: float) -> float:
    """dn/dT of air at constant pressure, 1/K."""
    return -refractivity(temperature_c, pressure_hpa) / (_ZERO_CELSIUS_K + temperature_c)


def bending(curvature_per_m: float, distance_m: float) -> Bending:
    """A beam of constant curvature: deviation curvature · distance² / 2, slope curvature · distance."""
    return Bending(
        500 * curvature_per_m * distance_m**2, math.degrees(math.atan(curvature_per_m * distance_m))
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    for name, metavar, low, high, default, meaning in (
        ("--gradient", "K/M", 0.0, 100.0, 1.0, "temperature gradient across the beam, K/m"),
        ("--temperature", "C", -60.0, 60.0, 20.0, "temperature of the air, °C"),
        ("--pressure", "HPA", 500.0, 1500.0, 1013.25, "pressure of the air, hPa"),
    ):
        help_text = f"{meaning} (default: {default:g})"
        parser.add_argument(name, type=_within(low, high), metavar=metavar, default=default, help=help_text)
    parser.add_argument(
        "--distance",
        type=_within(0.0, 10_000.0),
        nargs="+",
        metavar="M",
        default=[10.0, 25.0, 50.0, 100.0],
        help="distances from the laser to the unit, m (default: 10 25 50 100)",
    )


def run(options: argparse.Namespace) -> int:
    """Print a line for each distance."""
    air = options.temperature, options.pressure
    per_kelvin = index_per_kelvin(*air)
    print_lines("air at {:g} °C and {:g} hPa: ".format(*air) + f"n - 1 = {1e6 * refractivity(*air):.1f}e-6")
    print_lines(f"dn/dT = {1e6 * per_kelvin:.3f}e-6 per K")
    print_lines(f"gradient across the beam: {options.gradient:g} K/m")
    print_lines(_ROW.format("distance m", "deviation mm", "angle mm/m", "angle deg"))
    for distance_m in options.distance:
        bent = bending(abs(per_kelvin) * options.gradient, distance_m)
        numbers = f"{bent.deviation_mm:.3f}", f"{bent.angle_mm_per_m:.4f}", f"{bent.angle_deg:.5f}"
        print_lines(_ROW.format(f"{distance_m:g}", *numbers))
    print_lines("The beam bends towards the colder air. altd does not correct this.")
    return 0


def _within(low: float, high: float) -> Callable[[str], float]:
    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a number from {low:g} to {high:g}")
        return value

    return number
