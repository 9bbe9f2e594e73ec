"""``altd axis`` on the example of docs/machine.md: what is refused, and lines as they come."""

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.places import DOCS, ROOT

from altd.config import Installation, Machine
from altd.instruments.beam.points import MachinePoints

TUNNEL = ROOT / "examples" / "tunnel"
AXIS, BEAM, SETTINGS = (TUNNEL / name for name in ("axis.json", "beam.json", "unit.toml"))
LINE = (TUNNEL / "measurement.jsonl").read_text()
MESSAGE: dict[str, Any] = json.loads(LINE)
COMMAND = ("axis", "--config", SETTINGS, AXIS, BEAM)
COVARIANCE = MESSAGE["covariance"]
POINT = MESSAGE["points"]["cutterhead"]


def line(**changes: Any) -> str:
    return json.dumps({**MESSAGE, **changes}) + "\n"


def point(**changes: Any) -> dict[str, Any]:
    return {"cutterhead": {**POINT, **changes}}


def test_the_example_is_that_of_the_page_and_gives_its_numbers() -> None:
    outcome = altd_here(*COMMAND, TUNNEL / "measurement.jsonl")
    assert (outcome.status, outcome.err) == (0, "")
    (row,) = outcome.objects
    assert row["reason"] is None
    section = (DOCS / "machine.md").read_text().split("## In the tunnel")[1]
    shown = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", section, re.DOTALL)]
    assert shown == [json.loads(BEAM.read_text()), json.loads(AXIS.read_text()), row]


REFUSED = [
    ({"valid": False, "status": ["no_beam"]}, "invalid"),
    ({"points": point(right_mm=None)}, "not_known"),
    ({"points": point(sigma={"right_mm": 1.4, "up_mm": None})}, "not_known"),
    ({"points": {}}, "not_known"),
    ({"x_mm": None}, "not_known"),
    ({"covariance": [[None] * 4] * 4}, "not_known"),
    ({"points": point(right_mm=POINT["right_mm"] + 0.02)}, "other_settings"),
    ({"points": point(right_mm=POINT["right_mm"] + 0.01)}, None),
    ({"points": point(sigma={"right_mm": 0.5, "up_mm": 1.4})}, "other_settings"),
    ({"points": {**point(), "shield": POINT}}, "other_settings"),
    ({"x_mm": 24.0}, "other_settings"),
    ({"unit": "508243342"}, "other_unit"),
    ({"time": None}, "no_time"),
    ({"time": "2026-11-20T07:39:59.999Z"}, "before_survey"),
    ({"time": "2026-11-20T09:00:00.001Z"}, "distance_old"),
    ({"distance_m": 300.0}, "out_of_axis"),
    ({"distance_m": 62.4, "time": "2026-11-20T10:00:00+01:00"}, None),
    ({"distance_m": 62.4, "time": "2026-11-22T08:00:00Z"}, None),
]


@pytest.mark.parametrize(("changes", "reason"), REFUSED)
def test_a_measurement_without_a_place_has_a_row_with_the_reason(
    changes: dict[str, Any], reason: str | None
) -> None:
    outcome = altd_here(*COMMAND, stdin=line(**changes))
    assert (outcome.status, outcome.err) == (0, "")
    (row,) = outcome.objects
    assert (row["reason"], row["point"]) == (reason, "cutterhead")
    numbers = [name for name in row if re.search(r"_m{1,2}$", name)]
    assert len(numbers) == 12
    assert all((row[name] is None) == (reason is not None) for name in numbers)


UNREADABLE = [
    (line(x_mm="23.0"), 'x_mm: "23.0" is not a number'),
    (line(valid=1), "valid: 1 is neither true nor false"),
    (line(x_mm=float("nan")), "x_mm: nan is not a finite number"),
    (LINE.replace("-253.3508", "1e400"), "points.cutterhead.right_mm: inf is not a finite number"),
    (line(points=point(up_mm=True)), "points.cutterhead.up_mm: true is not a number"),
    (line(points=point(sigma={"right_mm": -1.0, "up_mm": 1.0})), "points.cutterhead.sigma.right_mm: -1.0 is"),
    (line(distance_m=62400.0), "distance_m: 62400.0 is too large"),
    (line(distance_m=-62.4), "distance_m: -62.4 is too small"),
    (line(time="2026-11-20T08:15:30.125"), 'time: "2026-11-20T08:15:30.125" is not a time'),
    (line(covariance=COVARIANCE[:3]), "covariance: is not a matrix"),
    (line(covariance=[row[:3] for row in COVARIANCE[:3]]), "covariance: is not a matrix"),
    (line(covariance=[[-each for each in row] for row in COVARIANCE]), "covariance: is not that of four"),
    (line(covariance=[COVARIANCE[0], [0.1, 0, 0, 0], *COVARIANCE[2:]]), "covariance: is not that of four"),
    ('{"sequence": 1}\n', "time: this key is missing"),
    (LINE[:900] + "\n", "is not JSON"),
    ("{" + " " * (1 << 20) + "}\n", "is longer than 1048576 bytes"),
    ("[]\n", "a list is not a table"),
    ('{"valid": true, ' + LINE[1:], "is not JSON: the key 'valid' occurs twice"),
]


@pytest.mark.parametrize(("bad", "said"), UNREADABLE)
def test_a_bad_line_is_reported_with_its_number_and_the_others_go_through(bad: str, said: str) -> None:
    outcome = altd_here(*COMMAND, stdin=line(sequence=161) + "\n" + bad + LINE)
    assert outcome.status == 2
    (fault,) = outcome.err.splitlines()
    assert fault.startswith(f"altd axis: stdin: line 3: {said}"), fault
    assert [(row["line"], row["reason"]) for row in outcome.objects] == [
        (1, None),
        (3, "unreadable"),
        (4, None),
    ]


def test_roll_of_an_inclinometer_is_that_of_the_message(tmp_path: Path) -> None:
    """At 40° the tangent, in which the covariance has it, differs from the angle."""
    roll_deg, sigma_deg = 40.0, 0.2
    stated = {
        **tomllib.loads(SETTINGS.read_text())["machine"],
        "roll_deg": roll_deg,
        "roll_sigma_deg": sigma_deg,
    }
    finished = MachinePoints(Machine.model_validate(stated), Installation())
    seen = [MESSAGE[key] for key in ("x_mm", "y_mm", "yaw_mm_per_m", "pitch_mm_per_m")]
    ((right, up, _),), (covariance,) = finished.places(seen, np.array(COVARIANCE), (roll_deg, sigma_deg))
    sigmas = dict(zip(("right_mm", "up_mm"), np.sqrt(np.diag(covariance)).tolist(), strict=False))
    of_roll = (
        1000 * math.tan(math.radians(roll_deg + 0.001)) - 1000 * math.tan(math.radians(roll_deg))
    ) / 0.001
    joint = [[*row, 0.0] for row in COVARIANCE] + [[0.0, 0.0, 0.0, 0.0, (of_roll * sigma_deg) ** 2]]
    inclinometer = '[inclinometer]\ndriver = "balluff_bsi_r11a0"\ndevice = "/dev/none"\n'
    settings = re.sub(r"\nroll_.*", "", SETTINGS.read_text()) + inclinometer
    (tmp_path / "unit.toml").write_text(settings)
    points = {"cutterhead": {"right_mm": right, "up_mm": up, "sigma": sigmas}}
    fields: dict[str, Any] = {"points": points, "roll_deg": roll_deg, "covariance": joint}
    command = ("axis", "--config", tmp_path / "unit.toml", AXIS, BEAM)
    outcome = altd_here(
        *command, stdin=line(**fields) + line(**{**fields, "roll_deg": None, "sequence": 161})
    )
    assert [row["reason"] for row in outcome.objects] == [None, "not_known"]


def test_a_repeated_measurement_is_not_a_new_one_and_one_that_is_not_live_is_named() -> None:
    outcome = altd_here(*COMMAND, stdin=LINE + LINE + line(sequence=161, status=["simulated", "rehearsal"]))
    assert [(row["reason"], row["status"]) for row in outcome.objects] == [
        (None, ""),
        ("repeated", ""),
        (None, "simulated rehearsal"),
    ]
    assert outcome.err == "altd axis: stdin: line 3: is not live: see status\n"


def test_documents_of_another_unit_or_another_direction_are_refused(tmp_path: Path) -> None:
    beam = json.loads(BEAM.read_text())
    for changes, said in (
        ({"serial": "ALT-0008"}, "serial: ALT-0008, the settings are those of ALT-0007"),
        ({"inclination_mm_per_m": 18.0}, "inclination_mm_per_m: 18, machine.beam_inclination_mm_per_m"),
        ({"azimuth_deg": "77"}, 'azimuth_deg: "77" is not a number'),
    ):
        (tmp_path / "b.json").write_text(json.dumps({**beam, **changes}))
        outcome = altd_here("axis", AXIS, tmp_path / "b.json", "--config", SETTINGS, stdin=LINE)
        assert refusal(outcome).startswith(f"altd axis: {tmp_path}/b.json: {said}")
    del beam["distance_m"], beam["distance_until"]
    beam["azimuth_deg"] *= 400 / 360  # in gon
    (tmp_path / "b.json").write_text(json.dumps(beam))
    outcome = altd_here(
        "axis",
        AXIS,
        tmp_path / "b.json",
        "--config",
        SETTINGS,
        stdin=LINE + line(sequence=161, distance_m=62.4),
    )
    assert [row["reason"] for row in outcome.objects] == ["no_distance", "out_of_axis"]


def test_lines_of_a_live_source_are_answered_as_they_come() -> None:
    command = [sys.executable, "-m", "altd.cli", *map(str, COMMAND), "--format", "csv"]
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, env=buffered, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for number in range(2):
            process.stdin.write(line(sequence=number).encode())
            process.stdin.flush()
            if number == 0:
                assert process.stdout.readline().startswith(b"line,sequence,time,")
            assert process.stdout.readline().startswith(f"{number + 1},{number},2026-11-20T08:15".encode())
        process.stdout.close()
        process.stdin.write(line(sequence=3).encode())
        process.stdin.close()
        assert process.wait(60) == 1  # the reader has ended
