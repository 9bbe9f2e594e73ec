"""Each contract between the rooms fails on an import that breaks it, and all hold as the project is."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from support.places import ROOT

PACKAGES = ("altd", "hw_sim", "studies", "benchmarks")
CONTRACTS: list[dict[str, str]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
    "importlinter"
]["contracts"]
BREAKS = {
    "One direction": ("altd/vision/frame_leds.py", "import altd.status.board"),
    "The settings": ("altd/config/keeping.py", "import altd.config.rules"),
    "An interface sees": ("altd/publish/http/answers.py", "import altd.measuring.calibration"),
    "A driver sees": ("altd/devices/grbl/line.py", "import altd.status.health"),
    "Drivers are known": ("altd/publish/http/answers.py", "import altd.devices.hwmon"),
    "The ingest knows": ("altd/fleet/table.py", "import altd.measuring.gate"),
    "Publishers do not know": ("altd/publish/serial/words.py", "import altd.publish.modbus.registers"),
    "Drivers do not know": ("altd/devices/gpio/lamps.py", "import altd.devices.grbl.line"),
    "Instruments do not know": ("altd/instruments/beam/solver.py", "import altd.instruments.toy"),
    "The unit never invents data": ("altd/app/parts.py", "import hw_sim.unit"),
    "The simulator shares no measuring code": ("hw_sim/unit.py", "import altd.mapping.polynomials"),
    "The studies are nobody's foundation": ("benchmarks/area.py", "import studies.bench"),
    "The pure rooms": ("altd/mapping/polynomials.py", "import asyncio"),
}
"""First words of a contract's name, and an import that breaks it."""


def broken(project: Path) -> set[str]:
    """The names of the contracts that do not hold."""
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-logo", "--no-cache"]
    shown = subprocess.run(
        command, cwd=project, capture_output=True, text=True, check=False, env={"COLUMNS": "300"}
    ).stdout
    verdicts = {
        contract["name"]: line
        for contract in CONTRACTS
        for line in shown.splitlines()
        if line.startswith(contract["name"]) and re.search(r" (KEPT|BROKEN)\b", line)
    }
    assert set(verdicts) == {contract["name"] for contract in CONTRACTS}, shown
    return {name for name, line in verdicts.items() if " BROKEN" in line}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A copy of the code, with a second instrument beside ``beam``."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "altd" / "instruments" / "toy.py").write_text('"""Nothing."""\n')
    return tmp_path


def test_each_contract_fails_on_an_import_that_breaks_it_and_holds_without(project: Path) -> None:
    assert broken(project) == set()
    for file, line in BREAKS.values():
        with (project / file).open("a") as source:
            source.write(f"{line}  # what the contract forbids\n")
    assert broken(project) == {contract["name"] for contract in CONTRACTS}


def test_the_self_check_knows_no_instrument_and_does_no_input_or_output(project: Path) -> None:
    with (project / "altd/selfcheck/history.py").open("a") as source:
        source.write("import altd.instruments.beam.solver\nimport asyncio\n")
    with (project / "altd/measuring/chain.py").open("a") as source:
        source.write("import altd.selfcheck.verdict\n")
    found = broken(project)
    assert {name.split(":")[0] for name in found} == {
        "One direction",
        "The pure rooms do no input or output",
    }


def test_there_is_a_breaking_import_for_each_contract() -> None:
    for contract in CONTRACTS:
        assert [start for start in BREAKS if contract["name"].startswith(start)], contract["name"]
