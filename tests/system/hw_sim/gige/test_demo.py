"""The whole daemon behind the simulated unit's GigE Vision cameras."""

import importlib.util
import re
import socket
from pathlib import Path

import pytest
from support.cli import altd
from support.foreign import need
from support.gige_unit import need_gige, new_addresses

from hw_sim.gige.loopback import GVCP_PORT


def options() -> list[str]:
    need_gige()
    need(importlib.util.find_spec("gi") is not None, "PyGObject is not installed (make programs venv)")
    return [part for name, address in new_addresses().items() for part in (f"--{name}", address)]


@pytest.mark.real_time
def test_the_daemon_measures_over_the_wire_what_the_truth_is(unit_3: Path) -> None:
    unit = ("--seed", "3", "--calibration", unit_3 / "cal.json")
    shown = altd("demo", "--gige", *options(), *unit, "--seconds", "10", module="hw_sim")
    assert shown.status == 0, shown.err
    lines = [line for line in shown.out.splitlines() if re.search(r" s  valid ", line)]
    assert len(lines) >= 5
    assert all(re.search(r" simulated\W+rehearsal$", line) for line in lines)
    summary = shown.out[shown.out.index("The demo has ended.") :]
    assert "of one core, daemon alone" in summary
    found = re.search(r"(\d+) exposures measured.*valid: (\d+)", summary, re.DOTALL)
    assert found is not None
    measured, valid = map(int, found.groups())
    made = [int(count) for count in re.findall(r"SIM-3-\w+ (\d+)", summary)]
    assert 0.8 * max(made) < measured < 1.2 * max(made)  # frames that a busy machine parts are two
    assert valid > 0.5 * measured
    for name, unit, limit in (
        ("x", "mm", 0.06),
        ("y", "mm", 0.06),
        ("yaw", "deg", 0.02),
        ("pitch", "deg", 0.02),
    ):
        rms = re.search(rf"^  {name} +([\d.]+) {unit}", summary, re.MULTILINE)
        assert rms is not None
        assert float(rms[1]) < limit


def test_a_camera_that_cannot_be_served_ends_the_demo_and_says_why(unit_3: Path) -> None:
    unit = ("--seed", "3", "--calibration", unit_3 / "cal.json")
    where = options()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((where[1], GVCP_PORT))
        shown = altd("demo", "--gige", *where, *unit, "--seconds", "5", module="hw_sim")
    assert shown.status == 2
    assert shown.err.splitlines() == [
        f"hw_sim: {where[1]}:{GVCP_PORT}: another camera is served there",
        "hw_sim: hw_sim gige: ended with status 2",
    ]
