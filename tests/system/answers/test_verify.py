"""``altd verify``: recordings of known beams against a calibration, by what was put into the pictures."""

import json
import math
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here, refusal
from support.played_unit import PlayedUnit
from support.recordings import Shot, grid, write

DEFLECTED = 0.08
"""Slope of a deflected beam, in x and in y."""
LIMITS = {"stage_mm": 0.002, "stage_scale_ppm": 50, "stage_square_mrad": 0.05, "beam_normal_mm_per_m": 0.1}
PLACES = grid(5, 4, 24.0)


def known_beams(
    path: Path,
    *,
    scale: float = 1.0,
    slope: float = 0.0,
    deflected: float = 0.0,
    turned: bool = False,
    kind: str = "scan",
    places: list[tuple[float, float]] = PLACES,
    **more: object,
) -> Path:
    """Beams whose places in the pictures are ``scale`` times those that the stage states."""
    sign = -1.0 if turned else 1.0
    shots: list[Shot] = []
    for x, y in places:
        at = sign * scale * x - 140 * deflected, sign * scale * y - 140 * deflected
        shots.append((at, (at[0] + 280 * (sign * slope + deflected), at[1] + 280 * deflected), (x, y)))
    about: dict[str, object] = {"limits": LIMITS, "turned_deg": 180 if turned else 0, "seat_mm_per_m": 0.02}
    if deflected:
        angle_deg = math.degrees(math.atan(DEFLECTED))
        about |= {
            "deflection_yaw_deg": angle_deg,
            "deflection_pitch_deg": angle_deg,
            "deflection_sigma_deg": 0.002,
        }
    return write(path, kind, shots, **(about | more))


def verified(unit: PlayedUnit, *arguments: object, status: int) -> dict[str, Any]:
    outcome = altd_here("verify", *arguments, "--calibration", unit.calibration, "--json")
    assert outcome.status == status, outcome
    (document,) = outcome.objects
    return document


def found(document: dict[str, Any], key: str) -> dict[str, Any]:
    return next(test for test in document["tests"] if test["key"] == key)


def test_both_orientations_of_a_right_unit_pass(played_unit: PlayedUnit, tmp_path: Path) -> None:
    upright = known_beams(tmp_path / "a", slope=0.001)
    turned = known_beams(tmp_path / "b", slope=0.001, turned=True)
    deflected = known_beams(tmp_path / "c", slope=0.001, deflected=DEFLECTED)
    document = verified(played_unit, upright, turned, deflected, status=0)
    assert (document["verdict"], document["reasons"], document["unit"]) == ("passed", [], "TEST-1")
    first, second, _ = document["sets"]
    assert (first["valid"], first["positions"], second["turned_deg"]) == (20, 20, 180.0)
    # a beam of 1 mm/m is 0.0573°, seen from the other side by a turned unit
    assert first["direction_deg"][0] == pytest.approx(0.0573, abs=0.004)
    assert second["direction_deg"][0] == pytest.approx(-0.0573, abs=0.004)
    assert found(document, "zero_yaw_deg")["value"] == pytest.approx(0.0, abs=0.004)
    # the seat of 0.02 mm/m in each orientation
    assert found(document, "zero_yaw_deg")["parts"]["reference"] == pytest.approx(0.00081, abs=1e-5)
    assert found(document, "scale_pitch_ppm")["value"] == pytest.approx(0.0, abs=2000.0)
    assert len(document["residuals"]) == 60


def test_a_distance_that_is_stated_wrong_fails_by_the_deflected_beam(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """The beam is deflected by 3 % more than the unit reads, as with a rear target 8 mm farther away."""
    upright, deflected = (known_beams(tmp_path / f"{d}", deflected=d) for d in (0.0, DEFLECTED * 1.03))
    document = verified(played_unit, upright, deflected, status=1)
    assert "distance of the targets is beyond its limit" in document["reasons"]
    assert found(document, "target_distance_mm")["value"] == pytest.approx(-8.4, abs=0.6)


def test_one_orientation_of_a_beam_of_one_direction_names_the_missing_sets(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    unknown = {key: sigma for key, sigma in LIMITS.items() if key != "beam_normal_mm_per_m"}
    document = verified(played_unit, known_beams(tmp_path / "a", limits=unknown), status=1)
    assert document["verdict"] == "not decided"
    assert [reason.split(" with ")[0] for reason in document["reasons"]] == [
        "zero of yaw: needs a set",
        "zero of pitch: needs a set",
        "scale of yaw: needs a set",
        "scale of pitch: needs a set",
        "distance of the targets: needs a set",
    ]


def test_a_deflected_scan_makes_no_calibration(tmp_path: Path) -> None:
    deflected = known_beams(tmp_path / "a", deflected=DEFLECTED)
    refused = refusal(altd_here("calibrate", deflected, "-o", tmp_path / "c.json"))
    why = "has a deflected beam: it verifies a calibration, and makes none"
    assert refused == f"altd calibrate: {deflected}: {why}"


def test_a_plan_states_what_each_test_will_detect(played_unit: PlayedUnit, tmp_path: Path) -> None:
    angle = "centre_x_mm = -8\ncentre_y_mm = -8\ndeflection_yaw_deg = 4.5\ndeflection_pitch_deg = 4.5\n"
    sets = {"a": "", "b": "turned_deg = 180\n", "c": f"{angle}deflection_sigma_deg = 0.002\n"}
    limits = "[scan.limits]\nstage_mm = 0.002\nstage_scale_ppm = 50\nstage_square_mrad = 0.05\n"
    files = []
    for name, more in sets.items():
        scan = f"[scan]\ncolumns = 5\nrows = 4\npitch_mm = 20\nseat_mm_per_m = 0.02\n{more}{limits}"
        files.append(tmp_path / f"{name}.toml")
        files[-1].write_text(f"{played_unit.config.read_text()}\n{scan}")
    decided = verified(played_unit, "--plan", *files, status=0)
    assert decided["verdict"] == "decides"
    zero = found(decided, "zero_yaw_deg")
    assert (zero["value"], zero["result"]) == (None, "decides")
    assert zero["detectable"] < zero["required"]
    undecided = verified(played_unit, "--plan", files[0], status=1)
    assert undecided["verdict"] == "not decided"
    refused = refusal(
        altd_here("verify", "--plan", files[0], "--calibration", played_unit.calibration, "-o", "x")
    )
    assert "--plan: has no -o and no --compare" in refused


def test_a_unit_that_reads_too_long_fails(played_unit: PlayedUnit, tmp_path: Path) -> None:
    outcome = altd_here(
        "verify", known_beams(tmp_path / "a", scale=1.002), "--calibration", played_unit.calibration
    )
    assert outcome.status == 1
    lines = outcome.out.splitlines()
    assert lines[0] == "unit TEST-1: FAILED"
    assert "  scale of x is beyond its limit" in lines
    scale = next(line for line in lines if line.startswith("scale of x, ppm"))
    assert float(scale.split()[4]) == pytest.approx(2000, abs=200)


def test_the_zero_of_one_orientation_is_held_against_the_stated_beam(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    document = verified(played_unit, known_beams(tmp_path / "a", slope=0.002), status=1)
    assert document["reasons"] == ["zero of yaw is beyond its limit"]
    assert found(document, "zero_yaw_deg")["value"] == pytest.approx(0.1146, abs=0.004)


def test_without_limits_nothing_is_decided(played_unit: PlayedUnit, tmp_path: Path) -> None:
    document = verified(played_unit, known_beams(tmp_path / "a", limits=None), status=1)
    assert (document["verdict"], document["reference"]) == ("not decided", None)
    assert document["reasons"] == ["the uncertainty of the reference is unknown: its header states no limits"]


def test_too_few_positions_decide_nothing(played_unit: PlayedUnit, tmp_path: Path) -> None:
    few = known_beams(tmp_path / "a", places=PLACES[:3])
    document = verified(played_unit, few, status=1)
    assert (document["verdict"], document["tests"]) == ("not decided", [])
    assert "too few positions: 3 valid" in document["reasons"][0]
    six = verified(played_unit, known_beams(tmp_path / "b", places=[*PLACES[:3], *PLACES[10:13]]), status=1)
    assert "too few positions: 6.0 degrees of freedom" in six["reasons"][0]


def test_positions_without_a_measurement_are_counted_with_their_reasons(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    shots: list[Shot] = [(place, place if n > 4 else None, place) for n, place in enumerate(PLACES)]
    document = verified(played_unit, write(tmp_path / "a", "scan", shots, limits=LIMITS), status=1)
    assert document["sets"][0]["invalid"] == {"rear_spot_missing": 5}
    assert document["reasons"][0] == f"{tmp_path / 'a'}: only 15 of 20 positions gave a valid measurement"


def test_a_measurement_with_known_positions_is_a_set(played_unit: PlayedUnit, tmp_path: Path) -> None:
    document = verified(played_unit, known_beams(tmp_path / "a", kind="measurement"), status=1)
    assert document["verdict"] == "not decided"
    assert document["sets"][0]["positions"] == 20


def test_page_and_json_are_written_and_compared_with_a_year_later(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    first, later = known_beams(tmp_path / "a"), known_beams(tmp_path / "b", scale=1.0005)
    verified(played_unit, first, "-o", tmp_path / "out", status=1)
    outcome = altd_here(
        *("verify", later, "--calibration", played_unit.calibration, "-o", tmp_path / "later"),
        *("--compare", tmp_path / "out" / "verification.json"),
    )
    assert "no significant change" in outcome.out
    document = json.loads((tmp_path / "later" / "verification.json").read_text())
    scale = next(one for one in document["comparison"]["changes"] if one["key"] == "scale_x_ppm")
    assert scale["change"] == pytest.approx(500, abs=60)
    assert document["comparison"]["same_calibration"] is True
    text = _text((tmp_path / "later" / "verification.html").read_text())
    for words in ("Verification of unit TEST-1", "Comparison with an earlier verification", "scale of x"):
        assert words in text


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["{beams}"], "beams: has no known positions (x_mm, y_mm) to verify the unit against"),
        (["{wrong_turn}"], "the measured positions are turned by "),
        (["{right}", "{copy}"], "copy: is the same recording as "),
        (["{right}", "{scan}"], "scan: made the calibration; verify it with another recording"),
        (
            ["{right}", "--compare", "{right}/recording.json"],
            "is not an output of `altd verify --json`: format",
        ),
        (["{right}", "--compare", "{other}"], "is of unit 'OTHER', not 'TEST-1'"),
        (["{right}", "--compare", "none.json"], "none.json: No such file or directory"),
    ],
)
def test_what_cannot_be_verified_is_one_line(
    arguments: list[str], line: str, played_unit: PlayedUnit, tmp_path: Path
) -> None:
    right, wrong_turn = known_beams(tmp_path / "a"), known_beams(tmp_path / "b", turned=True)
    header = json.loads((wrong_turn / "recording.json").read_text())
    (wrong_turn / "recording.json").write_text(json.dumps(header | {"turned_deg": 0}))
    copy = shutil.copytree(right, tmp_path / "copy")
    other = tmp_path / "other.json"
    nothing = {"calibration": {"sha256": ""}, "tests": [], "verdict": "passed", "unit": "OTHER"}
    other.write_text(
        json.dumps({"format": "altd-verification/1", "created": "2026-01-01T00:00:00Z"} | nothing)
    )
    files = {
        "beams": played_unit.beams,
        "right": right,
        "wrong_turn": wrong_turn,
        "other": other,
        "copy": copy,
        "scan": played_unit.folder / "scan",
    }
    filled = [argument.format(**files) for argument in arguments]
    refused = refusal(altd_here("verify", *filled, "--calibration", played_unit.calibration))
    assert line in refused


class _Words(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def _text(page: str) -> str:
    parser = _Words()
    parser.feed(page)
    return " ".join(parser.words)
