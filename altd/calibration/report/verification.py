"""The page of a verification, from its JSON object (docs/verify.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from altd.calibration.report.document import (
    Banner,
    Block,
    Document,
    Heading,
    Level,
    Picture,
    Row,
    Table,
    Words,
)
from altd.calibration.report.target_plots import ShownArea, nice_length, vectors
from altd.records import FloatArray, counted

_LEVELS = {"passed": Level.GOOD, "failed": Level.BAD, "not decided": Level.USABLE}
_ARROW_MM = 15.0
"""Length of the longest arrow as drawn."""
_PARTS = ("measurements", "reference", "calibration")
_LIMITS = {
    "stage_mm": ("positioning of the stage", "mm"),
    "stage_scale_ppm": ("scale of the stage", "ppm"),
    "stage_square_mrad": ("angle between the stage's axes", "mrad"),
    "beam_normal_mm_per_m": ("beam against the targets' normal", "mm/m"),
    "target_distance_mm": ("distance of the targets", "mm"),
    "temperature_k": ("temperature of the frame", "K"),
}


def verification_page(document: Mapping[str, Any]) -> Document:
    """Build the document of the object of ``answers.verify.verify``."""
    simulated = document["origin"] == "simulated"
    blocks = [
        *_origin(simulated),
        _verdict(document),
        *_tests(document),
        *_comparison(document["comparison"]),
        *_sets(document["sets"]),
        *_residuals(document["residuals"]),
        *_limits(document),
        *_inputs(document),
        Heading("Signature"),
        Table((), (("Date", ""), ("Name", ""), ("Signature", "")), (0.25, 0.75)),
    ]
    return Document(
        f"Verification of unit {document['unit']}",
        f"{counted(len(document['sets']), 'set')} · {document['created']} · {document['made_by']}",
        tuple(blocks),
        f"sha256:{document['calibration']['sha256']}",
        "SIMULATED" if simulated else "",
    )


def _origin(simulated: bool) -> list[Block]:
    if not simulated:
        return []
    return [Banner(Level.BAD, "Made from SIMULATED frames: not for a real unit.", ())]


def _verdict(document: Mapping[str, Any]) -> Block:
    verdict = document["verdict"]
    made = sum(test["detectable"] is not None for test in document["tests"])
    confidence = (
        f"{counted(made, 'test')}: a unit without an error fails none of them with a probability of at "
        f"least {100 * document['confidence']:g} %."
    )
    headline = {
        "passed": "Passed: the unit's errors are within its stated uncertainty and the requirement.",
        "failed": "Failed: an error exceeds the stated uncertainty or the requirement. Do not measure.",
        "not decided": "Not decided.",
    }[verdict]
    reasons = [f"{reason[0].upper()}{reason[1:]}." for reason in document["reasons"]]
    return Banner(_LEVELS[verdict], headline, (*reasons, *([confidence] if made else [])))


def _tests(document: Mapping[str, Any]) -> list[Block]:
    tests = document["tests"]
    if not tests:
        return []
    rows = tuple(
        (
            test["name"],
            *(_number(test, test[key]) for key in ("value", "sigma", "limit", "detectable", "required")),
            test["result"],
        )
        for test in tests
    )
    levels = tuple(_LEVELS[test["result"]] for test in tests)
    parts = tuple(
        (test["name"], *(_number(test, test["parts"][of]) for of in _PARTS))
        for test in tests
        if "measurements" in test["parts"]
    )
    blocks: list[Block] = [
        Heading("Tests"),
        Table(
            ("", "found", "standard uncertainty", "limit", "smallest detectable error", "required", ""),
            rows,
            (0.25, 0.13, 0.13, 0.12, 0.14, 0.11, 0.12),
            levels,
        ),
        Words(
            "Found: error of the unit. For a standard deviation: the experimental one, and "
            "the stated one as its uncertainty. An error of the smallest detectable size fails the test with "
            f"a probability of {100 * document['power']:g} %; a smaller one may pass. Required: error that "
            "alone uses up ±1 mm or ±1 mm/m; a test that cannot detect it is not decided. Greatest error: "
            "all errors of a quantity together, at the worst place of area and range, with twice the "
            "standard deviation. It passes if it is within the requirement by its expanded uncertainty, "
            "k = 2, and fails if it is beyond by as much (guarded acceptance and rejection, JCGM 106)."
        ),
    ]
    undecided = [f"{test['name']} ({test['why_not']})" for test in tests if test["why_not"]]
    if undecided:
        blocks.append(Words(f"Not decided: {'; '.join(undecided)}."))
    freedom = [
        f"{test['name']} {test['degrees_of_freedom']:.1f}"
        for test in tests
        if test["degrees_of_freedom"] is not None
    ]
    blocks += [
        Words(
            f"Effective degrees of freedom: {', '.join(freedom)}. Not part of this procedure: the zero of "
            "x and y and the rotation about z (the mounting)."
        ),
        Table(("standard uncertainty from", *_PARTS), parts, (0.4, 0.2, 0.2, 0.2)),
    ]
    return blocks


def _number(of: Mapping[str, Any], value: float | None) -> str:
    return "-" if value is None else f"{_rounded(value, of['decimals'])}{of['unit']}"


def _rounded(value: float, decimals: int) -> str:
    """Format a number with fixed decimals; zero has no sign."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def _comparison(comparison: Mapping[str, Any] | None) -> list[Block]:
    if comparison is None:
        return []
    changes = comparison["changes"]
    rows = tuple(
        (
            one["name"],
            *(_number(one, one[key]) for key in ("before", "now", "change", "sigma", "limit")),
            "changed" if one["changed"] else "no change",
        )
        for one in changes
    )
    same = "the same calibration" if comparison["same_calibration"] else "another calibration"
    return [
        Heading("Comparison with an earlier verification"),
        Words(f"Of {comparison['created']}, {same}, verdict {comparison['verdict']}."),
        Table(
            ("", "before", "now", "change", "uncertainty", "limit", ""),
            rows,
            (0.25, 0.12, 0.12, 0.12, 0.13, 0.12, 0.14),
            tuple(Level.USABLE if one["changed"] else Level.GOOD for one in changes),
        ),
    ]


def _sets(sets: Sequence[Mapping[str, Any]]) -> list[Block]:
    rows = []
    for number, one in enumerate(sets, start=1):
        mounted = ("-",) * 3
        if "offset_mm" in one:
            mounted = (
                ", ".join(_rounded(value, 3) for value in one["offset_mm"]),
                _rounded(one["rotation_mrad"], 2),
                ", ".join(_rounded(value, 4) for value in one["direction_deg"]),
            )
        invalid = ", ".join(f"{reason} {count}" for reason, count in one["invalid"].items())
        turned = f"{one['turned_deg']:g}"
        deflected = ", ".join(f"{angle:.4g}" for angle in one["deflection_deg"])
        rows.append(
            (
                str(number),
                turned,
                deflected,
                f"{one['valid']} of {one['positions']}",
                invalid or "none",
                *mounted,
            )
        )
    return [
        Heading("Sets"),
        Table(
            (
                *("set", "turned, °", "deflected, °", "valid", "not valid"),
                *("zero x, y, mm", "rotation, mrad", "yaw, pitch, °"),
            ),
            tuple(rows),
            (0.05, 0.1, 0.13, 0.11, 0.13, 0.18, 0.13, 0.17),
        ),
        Words("Zero, rotation and direction of a set depend on its mounting; no test is based only on them."),
    ]


def _residuals(residuals: Sequence[Mapping[str, Any]]) -> list[Block]:
    if not residuals:
        return []
    places = np.array([[one["x_mm"], one["y_mm"]] for one in residuals])
    plane = ShownArea([places])
    pictures = []
    for title, keys, unit, scale in (
        ("x, y", ("dx_mm", "dy_mm"), "µm", 1000.0),
        ("yaw, pitch", ("dyaw_deg", "dpitch_deg"), "m°", 1000.0),
    ):
        left = scale * np.array([[one[key] for key in keys] for one in residuals])
        pictures.append(_picture(plane, title, places, left, unit))
    caption = "Residuals of the fit at the places on the front target, seen along the beam."
    return [Heading("Residuals"), Row(tuple(pictures), caption)]


def _picture(plane: ShownArea, title: str, places_mm: FloatArray, left: FloatArray, unit: str) -> Picture:
    longest = float(np.linalg.norm(left, axis=1).max())
    mm_per_unit = _ARROW_MM / longest if longest > 0 else 1.0
    key = nice_length(_ARROW_MM / mm_per_unit)
    draw = vectors(plane, title, places_mm, mm_per_unit * left, (mm_per_unit * key, f"{key:g} {unit}"))
    return Picture(f"residuals of {title}", plane.height_in(), draw)


def _limits(document: Mapping[str, Any]) -> list[Block]:
    reference, calibration = document["reference"] or {}, document["calibration"]["limits"]
    rows = tuple(
        (words, *(_stated(limits.get(key), unit) for limits in (reference, calibration)))
        for key, (words, unit) in _LIMITS.items()
    )
    return [
        Heading("Stated limits, 1 sigma"),
        Table(("", "of the reference", "of the calibration"), rows, (0.5, 0.25, 0.25)),
    ]


def _stated(value: float | None, unit: str) -> str:
    return "not stated" if value is None else f"{value:g} {unit}"


def _inputs(document: Mapping[str, Any]) -> list[Block]:
    calibration = document["calibration"]
    facts = [
        ("Calibration", f"{Path(calibration['path']).name}, created {calibration['created']}"),
        ("SHA-256 of the calibration file", calibration["sha256"]),
    ]
    for number, one in enumerate(document["sets"], start=1):
        described = ", ".join(filter(None, (one["recording"], one["note"], one["start"])))
        facts += [(f"Set {number}", described), (f"SHA-256 of set {number}", one["sha256"])]
    facts.append(("Made with", document["made_by"]))
    return [Heading("Inputs"), Table((), tuple(facts), (0.25, 0.75))]
