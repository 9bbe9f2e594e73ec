"""``altd calibrate --report`` as a process."""

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.cli import Outcome, altd, altd_here, refusal
from support.places import ROOT
from support.recordings import write_scan

WITHOUT_MATPLOTLIB = "import sys; sys.modules['matplotlib'] = None"


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("scan") / "rec", columns=5, rows=4)


def calibrate_without_matplotlib(*arguments: object) -> Outcome:
    program = (
        f"{WITHOUT_MATPLOTLIB}; from altd.cli.main import main; sys.exit(main(['calibrate', *sys.argv[1:]]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def test_a_scan_gives_calibration_page_and_sheets(scan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "cal.html").write_text("older")
    done = altd("calibrate", scan, "-o", tmp_path / "cal.json", "--report", folder)
    assert (done.status, done.err) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cal.json", "report"]
    assert sorted(path.name for path in folder.iterdir()) == ["cal-budget.json", "cal.html", "cal.pdf"]
    assert (folder / "cal.pdf").read_bytes().startswith(b"%PDF")
    page = (folder / "cal.html").read_text()
    printed = re.findall(r"\d\.\d{4} / \d\.\d{4} / \d\.\d{4}", done.out)
    assert len(printed) == 2
    assert all(numbers in page for numbers in printed)
    assert f"altd calibrate {scan} -o {tmp_path / 'cal.json'} --report {folder}" in page
    assert f"report: {folder / 'cal.html'}" in done.out


@pytest.mark.parametrize("further", [(), ("other",)])
def test_a_recording_behind_report_is_not_taken_for_its_folder(
    scan: Path, tmp_path: Path, further: tuple[str, ...]
) -> None:
    line = refusal(altd_here("calibrate", "-o", tmp_path / "cal.json", "--report", scan, *further))
    assert line == f"altd calibrate: --report: {scan} is a recording: write --report after the recordings"


@pytest.mark.usefixtures("undrawn")
def test_without_a_folder_the_report_stands_beside_the_calibration_and_names_it(
    scan: Path, tmp_path: Path
) -> None:
    done = altd_here("calibrate", "-o", tmp_path / "unit-7.json", "--report", "--", scan)
    assert (done.status, done.err) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("unit-7-budget.json", "unit-7.html", "unit-7.json", "unit-7.pdf")
    ]
    page, checksum = (tmp_path / "unit-7.html").read_text(), checksum_of_file(tmp_path / "unit-7.json")
    assert f'<meta name="altd-calibration" content="{checksum}">' in page[:1024]
    assert hashlib.sha256((tmp_path / "unit-7.json").read_bytes()).hexdigest() in page, "for a person"


@pytest.mark.usefixtures("undrawn")
def test_with_facts_the_report_is_a_certificate_with_xml(scan: Path, tmp_path: Path) -> None:
    facts = ROOT / "config" / "certificate.toml"
    done = altd_here("calibrate", scan, "-o", tmp_path / "cal.json", "--certificate", facts)
    assert (done.status, done.err) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cal-budget.json",
        "cal.html",
        "cal.json",
        "cal.pdf",
        "cal.xml",
    ]
    assert "Calibration certificate 2026-117" in (tmp_path / "cal.html").read_text()
    assert ElementTree.parse(tmp_path / "cal.xml").getroot().tag.endswith("digitalCalibrationCertificate")


def test_wrong_facts_end_the_command_before_any_work(scan: Path, tmp_path: Path) -> None:
    facts = tmp_path / "facts.toml"
    facts.write_text((ROOT / "config" / "certificate.toml").read_text().replace("number =", "nummer ="))
    done = altd_here("calibrate", scan, "-o", tmp_path / "cal.json", "--certificate", facts)
    assert (done.status, done.out) == (2, "")
    [said] = done.err.splitlines()
    assert said.startswith(
        f"altd calibrate: {facts}: line 2, column 1: nummer: there is no such key; possible: "
    )
    assert said.endswith("; did you mean `number`?")
    assert list(tmp_path.iterdir()) == [facts]


def checksum_of_file(path: Path) -> str:
    return str(json.loads(path.read_text())["checksum"])


def test_without_matplotlib_the_extra_is_named_before_any_work(tmp_path: Path) -> None:
    output, folder = tmp_path / "cal.json", tmp_path / "report"
    done = calibrate_without_matplotlib(tmp_path / "none", "-o", output, "--report", folder)
    assert refusal(done) == (
        "altd calibrate: --report: needs matplotlib, which comes with the extra altd[report]"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_calibration_without_report_needs_no_matplotlib(scan: Path, tmp_path: Path) -> None:
    done = calibrate_without_matplotlib(scan, "-o", tmp_path / "cal.json")
    assert (done.status, done.err) == (0, "")
