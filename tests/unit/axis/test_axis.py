"""The designed axis and the surveyed beam: against Fresnel integrals, closed forms and drawn errors."""

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.special import fresnel
from support.places import ROOT

from altd.axis import AxisDocument, BeamLine, fault_of
from altd.config import Installation, Machine
from altd.instruments.beam.points import MachinePoints
from altd.records import FloatArray

TUNNEL = ROOT / "examples" / "tunnel"
AXIS: dict[str, Any] = json.loads((TUNNEL / "axis.json").read_text())
BEAM: dict[str, Any] = json.loads((TUNNEL / "beam.json").read_text())


def element(length_m: float, start_m: float | None, end_m: float | None) -> dict[str, float | None]:
    return {"length_m": length_m, "start_radius_m": start_m, "end_radius_m": end_m}


def axis_of(elements: list[dict[str, float | None]], end: FloatArray, **start: float) -> AxisDocument:
    """An axis from (0, 0) to the north, level, with the end that the test computed."""
    length_m = sum(each["length_m"] or 0.0 for each in elements)
    level = [{"chainage_m": at, "height_m": 0.0} for at in (0.0, length_m)]
    return AxisDocument.model_validate(
        {
            "format": "altd-axis/1",
            "name": "test",
            "max_offset_m": 5.0,
            "start": {"chainage_m": 0.0, "east_m": 0.0, "north_m": 0.0, "azimuth_deg": 0.0, **start},
            "horizontal": elements,
            "end": {"east_m": float(end[0]), "north_m": float(end[1])},
            "vertical": level,
        }
    )


def on_clothoid(way_m: float, length_m: float, radius_m: float) -> FloatArray:
    """East and north on a clothoid that begins straight to the north, by Fresnel integrals."""
    scale = math.sqrt(math.pi * length_m * abs(radius_m))
    sine, cosine = fresnel(way_m / scale)
    return np.array([math.copysign(scale * sine, radius_m), scale * cosine])


@pytest.mark.parametrize(("length_m", "radius_m"), [(300.0, 250.0), (300.0, -120.0), (60.0, 400.0)])
def test_a_clothoid_is_that_of_fresnel(length_m: float, radius_m: float) -> None:
    """Its stated accuracy is 0.01 mm over 300 m; this limit is 0.001 mm."""
    end = on_clothoid(length_m, length_m, radius_m)
    axis = axis_of([element(length_m, None, radius_m)], end).axis
    assert np.abs(axis.nodes[-1] - end).max() < 1e-6
    for way_m in np.linspace(0.0, length_m, 23).tolist():
        turn = way_m**2 / (2 * length_m * radius_m)
        right = np.array([math.cos(turn), -math.sin(turn)])
        for offset_m in (0.0, 2.5, -4.0):
            place = np.append(on_clothoid(way_m, length_m, radius_m) + offset_m * right, 0.7)
            (foot,) = axis.feet(place)
            assert (foot.chainage_m, foot.right_m, foot.up_m) == pytest.approx(
                (way_m, offset_m, 0.7), abs=1e-6
            )


def test_arcs_turn_by_their_sign_and_feet_are_right_at_joints_and_beyond_a_half_turn() -> None:
    """A straight line, more than half a circle to the right, and a straight line back."""
    radius_m, turn = 50.0, 1.25 * math.pi
    arc_end = np.array([radius_m * (1 - math.cos(turn)), 40.0 + radius_m * math.sin(turn)])
    out = np.array([math.sin(turn), math.cos(turn)])
    elements = [
        element(40.0, None, None),
        element(radius_m * turn, 50.0, 50.0),
        element(30.0, None, None),
    ]
    axis = axis_of(elements, arc_end + 30.0 * out).axis
    for angle in np.linspace(0.0, turn, 29).tolist():
        outwards = np.array([-math.cos(angle), math.sin(angle)])
        place = np.array([radius_m, 40.0]) + (radius_m + 3.0) * outwards
        (foot,) = axis.feet(np.append(place, 0.0))
        assert (foot.chainage_m, foot.right_m) == pytest.approx((40.0 + radius_m * angle, -3.0), abs=1e-8)
    end_m = 70.0 + radius_m * turn
    for beyond_m, count in ((-1e-9, 1), (0.001, 0), (1.0, 0)):
        assert len(axis.feet(np.append(arc_end + (30.0 + beyond_m) * out, 0.0))) == count
        assert len(axis.feet(np.array([1.0, -beyond_m, 0.0]))) == count
    (last,) = axis.feet(np.append(arc_end + 29.999 * out, 0.0))
    assert last.chainage_m == pytest.approx(end_m - 0.001)
    for far in ([5.1, 20.0, 0.0], [0.0, 20.0, -5.1], [50.0, 40.0, 0.0]):
        assert axis.feet(np.array(far)) == []


def test_an_axis_that_returns_to_a_place_has_two_feet_there() -> None:
    circle = axis_of([element(2 * math.pi * 50.0 + 20.0, 50.0, 50.0)], np.array([50 * (1 - math.cos(0.4)),
                     50 * math.sin(0.4)]))  # fmt: skip
    assert [len(circle.axis.feet(np.array([at, 5.0, 0.0]))) for at in (0.3, 99.7)] == [2, 1]


def test_heights_follow_gradients_and_parabolas() -> None:
    axis = AxisDocument.model_validate(AXIS).axis
    chainages = np.linspace(1000.0, 1280.0, 2801)
    heights, gradients = np.array([axis.height(at) for at in chainages]).T
    assert np.allclose(np.diff(heights) / np.diff(chainages), (gradients[1:] + gradients[:-1]) / 2, atol=1e-9)
    bends = np.diff(gradients) / np.diff(chainages)
    inside = (chainages[1:] > 1080.05) & (chainages[:-1] < 1159.95)
    assert np.allclose(bends[inside], 0.030 / 80.0, atol=1e-9)
    assert np.allclose(bends[~inside], 0.0, atol=1e-9)
    assert axis.height(1000.0) == pytest.approx((412.0, -0.020))
    assert axis.height(1280.0) == pytest.approx((411.2, 0.010))


def changed(document: dict[str, Any], place: str, value: object) -> dict[str, Any]:
    """The document with another value at a place, or without it."""
    document = copy.deepcopy(document)
    *above, last = [int(key) if key.isdecimal() else key for key in place.split(".")]
    table: Any = document
    for key in above:
        table = table[key]
    if value is ...:
        del table[last]
    else:
        table[last] = value
    return document


BAD_AXES = [
    ("start.azimuth_deg", 80.5556, "end: the elements end at"),  # 72.5° in gon
    ("start.azimuth_deg", 1.2654, "end: the elements end at"),  # in rad
    ("start.azimuth_deg", 432.5, "start.azimuth_deg: 432.5 is too large"),
    ("end.east_m", 5274.526, "end: the elements end at 5274.511, 8031.081"),
    ("horizontal.2.start_radius_m", -400.0, "end: the elements end at"),
    ("horizontal.1.length_m", 60000.0, "end: the elements end at"),  # in mm
    ("horizontal.1.length_m", "60", 'horizontal.1.length_m: "60" is not a number'),
    ("horizontal.2.end_radius_m", 7.9, "horizontal.2.end_radius_m: 7.9 is below 2 times max_offset_m"),
    ("horizontal.2.end_radius_m", 0.0, "horizontal.2.end_radius_m: 0 is below 2 times max_offset_m"),
    ("horizontal.2.end_radius_m", ..., "horizontal.2.end_radius_m: this key is missing"),
    ("horizontal", [], "horizontal: a list has too few elements"),
    ("start.east_m", float("nan"), "start.east_m: nan is not a finite number"),
    ("vertical.1.height_m", 409600.0, "vertical.1: is behind or steeper than 500 mm/m"),
    ("vertical.2.chainage_m", 1120.0, "vertical.2: is behind or steeper than 500 mm/m"),
    ("vertical.1.curve_length_m", 241.0, "vertical.1: its curve overlaps the one before"),
    ("vertical.2.curve_length_m", 1.0, "vertical: the first and the last have no curve"),
    ("vertical.2.chainage_m", 1279.0, "vertical: does not reach from 1000.000 to 1280.000"),
    ("vertical.0.chainage_m", 1001.0, "vertical: does not reach from 1000.000 to 1280.000"),
    ("format", "altd-axis/2", 'format: "altd-axis/2" is not possible'),
    ("units", "m", "units: there is no such key"),
]
BAD_BEAMS = [
    ("azimuth_deg", -3.0, "azimuth_deg: -3.0 is too small"),
    ("sigma_azimuth_deg", 0.0, "sigma_azimuth_deg: 0.0 is too small"),
    ("distance_m", 62400.0, "distance_m: 62400.0 is too large"),
    ("distance_until", ..., "distance_m: needs distance_until"),
    ("time", "2026-11-20T07:40:00", 'time: "2026-11-20T07:40:00" is not a time such as'),
    ("time", "0001-01-01T00:00:00+01:00", 'time: "0001-01-01T00:00:00+01:00" is not a time such as'),
    ("time", 1763600000, "time: 1763600000 is not a time such as"),
    ("serial", ..., "serial: this key is missing"),
    ("by", "", 'by: "" is too short'),
]


@pytest.mark.parametrize(
    ("document", "place", "value", "said"),
    [
        *((AxisDocument, *case) for case in BAD_AXES),
        *((BeamLine, *case) for case in BAD_BEAMS),
    ],
)
def test_a_bad_document_has_one_fault_with_its_place(
    document: type[AxisDocument] | type[BeamLine], place: str, value: object, said: str
) -> None:
    with pytest.raises(ValidationError) as refused:
        document.model_validate(changed(AXIS if document is AxisDocument else BEAM, place, value))
    assert fault_of(refused.value).startswith(said)


def test_the_way_along_the_beam_is_that_of_vectors() -> None:
    """From where the beam meets z = 0 to the foot of the point, in the unit frame without a mounting."""
    lever, (x, y, yaw, pitch) = np.array([310.0, -1250.0, 4800.0]), (23.0, -14.0, 40.0, -30.0)
    point = {"name": "p", "x_mm": 310.0, "y_mm": -1250.0, "z_mm": 4800.0, "sigma_mm": 0.0}
    machine = Machine.model_validate({"points": [point], "mount_sigma_deg": 0.0})
    along = np.array([yaw / 1000, pitch / 1000, 1.0])
    along /= np.linalg.norm(along)
    for plane_mm in (0.0, -1500.0):
        seen = x + yaw * plane_mm / 1000, y + pitch * plane_mm / 1000, yaw, pitch
        points = MachinePoints(machine, Installation(reference_plane_mm=plane_mm))
        places, _ = points.places(seen, np.zeros((4, 4)), (2.0, 0.0))
        assert places[0, 2] == pytest.approx((lever - [x, y, 0.0]) @ along, abs=1e-9)


@pytest.mark.long
def test_sigma_agrees_with_monte_carlo() -> None:
    """All that is uncertain is drawn 4000 times: survey, distance, beam, roll, mounting and lever."""
    rng = np.random.default_rng(59)
    axis, beam = AxisDocument.model_validate(AXIS).axis, BeamLine.model_validate(BEAM)
    beam = beam.model_copy(update={"sigma_azimuth_deg": 0.003, "sigma_distance_mm": 20.0})
    lever_mm, sigma_mm, sigma_deg, roll_deg = np.array([900.0, -1250.0, 4800.0]), 2.0, 0.05, 2.0
    seen = np.array([23.0, -14.0, 40.0, -30.0])
    root = np.array([[0.4, 0, 0, 0], [0, 0.4, 0, 0], [-0.3, 0, 0.2, 0], [0, -0.3, 0, 0.2]])

    point = {"name": "p", "sigma_mm": sigma_mm, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0}
    settings = {"mount_sigma_deg": sigma_deg, "beam_inclination_mm_per_m": -18.0}
    machine = Machine.model_validate({"points": [point], **settings})

    def points(lever_mm: FloatArray, mount_deg: FloatArray) -> MachinePoints:
        of = dict(zip(("x_mm", "y_mm", "z_mm"), lever_mm.tolist(), strict=True))
        names = ("mount_yaw_deg", "mount_pitch_deg", "mount_roll_deg")
        update: dict[str, Any] = dict(zip(names, mount_deg.tolist(), strict=True))
        update["points"] = (machine.points[0].model_copy(update=of),)
        return MachinePoints(machine.model_copy(update=update), Installation())

    mount_deg = np.array([3.0, -1.0, 4.0])
    places, covariances = points(lever_mm, mount_deg).places(seen.tolist(), root @ root.T, (roll_deg, 0.05))
    place, covariance = beam.place(62.4, places[0], covariances[0])
    (foot,) = axis.feet(place)
    sigmas = np.sqrt(np.diag(foot.normal @ covariance @ foot.normal.T))
    fields = ["east_m", "north_m", "height_m", "azimuth_deg", "inclination_mm_per_m"]
    scales = np.array([3.0, 3.0, 2.0, 0.003, beam.sigma_inclination_mm_per_m]) * [1e-3, 1e-3, 1e-3, 1, 1]
    draws = []
    for _ in range(4000):
        other = points(lever_mm + rng.normal(0, sigma_mm, 3), mount_deg + rng.normal(0, sigma_deg, 3))
        drawn = (seen + root @ rng.normal(size=4)).tolist()
        where, _ = other.places(drawn, np.zeros((4, 4)), (roll_deg + rng.normal(0, 0.05), 0.0))
        values = [getattr(beam, field) for field in fields] + scales * rng.normal(size=5)
        survey = beam.model_copy(update=dict(zip(fields, values.tolist(), strict=True)))
        there, _ = survey.place(62.4 + rng.normal(0, 0.020), where[0], np.zeros((3, 3)))
        (at,) = axis.feet(there)
        draws.append([1000 * at.chainage_m, 1000 * at.right_m, 1000 * at.up_m])
    ratios = sigmas / np.std(draws, axis=0)
    print("stated sigma / drawn, chainage, right, up:", ratios.round(3))
    assert ratios == pytest.approx([1.0, 1.0, 1.0], abs=0.04)
