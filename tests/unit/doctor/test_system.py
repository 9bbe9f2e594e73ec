"""Libraries, clock, disk and calibration; and the command as a whole."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from support.cli import altd_here, refusal
from support.foreign import need_program
from support.played_unit import PlayedUnit
from support.unit_toml import write_config

from altd.calibration.file import load_calibration, save_calibration
from altd.config import load_config
from altd.devices import aravis
from altd.doctor import checks, system
from altd.doctor.checks import in_lines
from altd.process.machine import Finding, Verdict
from altd.records import Origin
from altd.vision import kernel

from .conftest import Tree, configured, says

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)


class TestProcessors:
    @pytest.fixture
    def stat(self, tree: Tree) -> Callable[..., None]:
        """Write the processor time, in seconds, of the host and of two programs."""
        ticks = os.sysconf("SC_CLK_TCK")

        def write(host: float = 0.0, compiler: float = 0.0) -> None:
            steal = round(host * ticks * (os.cpu_count() or 1))
            tree.write("proc/stat", f"cpu  9 0 9 9 0 0 0 {steal} 0 0")
            tree.write("proc/7/stat", f"7 (cc1) R {'0 ' * 10}{round(compiler * ticks)} 0 0")
            tree.write("proc/8/stat", f"8 (a ) b) S {'0 ' * 10}5 5 0")

        write()
        return write

    def test_programs_that_take_them_are_named(self, tree: Tree, stat: Callable[..., None]) -> None:
        tree.write("proc/pressure/cpu", "some avg10=99.00 avg60=63.20 avg300=1.00 total=1")
        (finding,) = system.processors(tree.machine, lambda _: stat(compiler=0.8))
        assert finding.verdict is Verdict.WARNING
        assert finding.text == (
            "programs waited 63% of the last minute for a processor; busiest now: cc1 (80%), a ) b (0%)"
        )

    def test_a_host_that_takes_them_away(self, tree: Tree, stat: Callable[..., None]) -> None:
        (finding,) = system.processors(tree.machine, lambda _: stat(host=0.3))
        assert (finding.verdict, finding.text[-22:]) == (Verdict.WARNING, "takes 30% of them away")

    def test_a_quiet_computer(self, tree: Tree) -> None:
        tree.write("proc/pressure/cpu", "some avg10=9.00 avg60=4.00 avg300=1.00 total=1")
        (finding,) = system.processors(tree.machine, lambda _: None)
        assert finding == Finding.good("processors", "programs waited 4% of the last minute for a processor")

    def test_a_kernel_that_does_not_report_it(self, tree: Tree) -> None:
        (finding,) = system.processors(tree.machine, lambda _: None)
        assert finding.verdict is Verdict.SKIPPED


class TestLibraries:
    def test_those_that_are_there(self) -> None:
        (finding,) = (found for found in system.libraries(None) if found.subject == "library gpiod")
        assert (finding.verdict, finding.text) == (Verdict.GOOD, "installed")

    @pytest.mark.parametrize("is_compiled", [True, False])
    def test_whether_the_fit_is_compiled(self, is_compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(kernel, "is_compiled", lambda: is_compiled)
        monkeypatch.setattr(kernel, "description", "numpy: altd was built without a C compiler")
        finding = next(system.libraries(None))
        assert finding.subject == "spot fit"
        assert finding.verdict is (Verdict.GOOD if is_compiled else Verdict.WARNING)
        assert ("without a C compiler" in finding.text) is not is_compiled

    def test_one_that_is_missing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for module in [module for module in sys.modules if module.split(".")[0] == "gpiod"]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, "gpiod", None)
        assert says(list(system.libraries(None)), Verdict.ERROR, "gpiod").subject == "library gpiod"

    def test_aravis_is_wrong_only_for_who_needs_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "gi", None)
        says(list(system.libraries(None)), Verdict.WARNING, "GigE Vision")
        camera = {"driver": "aravis", "device": "192.168.77.20"}
        config = configured(cameras={"front": camera, "rear": camera})
        _, finding = system.libraries(config)
        assert finding.verdict is Verdict.ERROR
        assert [found.subject for found in system.libraries(configured())] == ["spot fit"]

    def test_the_remedy_names_the_part_that_is_missing(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def remedy() -> str:
            return says(list(system.libraries(None)), Verdict.WARNING, "GigE Vision").remedy

        monkeypatch.setitem(sys.modules, "gi", None)
        monkeypatch.setattr(aravis, "DEBIAN_GI", tmp_path / "none")
        assert remedy().startswith("sudo apt-get install python3-gi gir1.2-aravis-0.8 ")
        monkeypatch.setattr(aravis, "DEBIAN_GI", tmp_path)  # installed, but not for this Python
        assert "apt-get" not in remedy()
        assert "/usr/bin/python3 -m venv --system-site-packages" in remedy()
        without_typelib = SimpleNamespace(require_version=Mock(side_effect=ValueError("not available")))
        monkeypatch.setitem(sys.modules, "gi", without_typelib)
        assert remedy().startswith("sudo apt-get install gir1.2-aravis-0.8 ")


class TestClock:
    def test_one_that_is_kept(self) -> None:
        assert says(list(system.clock(NOON, True)), Verdict.GOOD, "synchronised with a time server")

    def test_one_that_nobody_keeps(self) -> None:
        assert "set-ntp" in says(list(system.clock(NOON, False)), Verdict.ERROR, "not synchronised").remedy
        assert says(list(system.clock(NOON, None)), Verdict.WARNING, "not known")

    def test_one_that_was_never_set(self) -> None:
        assert says(list(system.clock(datetime(1970, 1, 1, tzinfo=UTC), True)), Verdict.ERROR, "1970-01-01")

    def test_the_kernel_is_asked_as_c_does(self, tmp_path: Path) -> None:
        (tmp_path / "ask.c").write_text(
            "#include <sys/timex.h>\n"
            "int main(void) {\n"
            "    struct timex t = {0};\n"
            "    return adjtimex(&t) < 0 ? 2 : !!(t.status & STA_UNSYNC);\n"
            "}\n"
        )
        subprocess.run([need_program("gcc"), "-o", tmp_path / "ask", tmp_path / "ask.c"], check=True)
        status = subprocess.run([tmp_path / "ask"], check=False).returncode
        assert system.clock_is_kept() == {0: True, 1: False, 2: None}[status]


def test_a_desk_unit_is_not_asked_for_parts_that_it_lacks() -> None:
    unit = {"serial": "D-1", "calibration": "/nowhere/calibration.json", "kind": "desk"}
    (finding,) = system.desk(configured(unit=unit))
    assert finding.verdict is Verdict.SKIPPED
    assert finding.text.startswith("does not apply: frame LEDs and self-check, ")
    lamps = {"driver": "gpiod", "chip": "board", "lines": ["LED1", "LED2"]}
    (finding,) = system.desk(configured(unit=unit, lamps=lamps))
    assert "frame LEDs" not in finding.text, "those that it has are checked"
    assert list(system.desk(configured())) == []


def test_a_disk_that_is_full(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    assert says(list(system.disk(tree.machine)), Verdict.GOOD, "GB free")
    monkeypatch.setattr(system, "MIN_FREE_BYTES", 1 << 62)
    assert "du" in says(list(system.disk(tree.machine)), Verdict.ERROR, "GB free").remedy


@pytest.fixture(scope="module")
def unit(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a config whose recording and calibration are good; the calibration is simulated."""
    folder = tmp_path_factory.mktemp("unit")
    shutil.copytree(played_unit.folder, folder, dirs_exist_ok=True)
    known = load_calibration(played_unit.calibration)
    simulated = tuple(replace(target, origin=Origin.SIMULATED) for target in known.targets)
    save_calibration(replace(known, targets=simulated), folder / "cal.json")
    write_config(folder / "altd.toml", folder / "cal.json", folder / "scan")
    return folder


def examined(unit: Path, old: str, by: str) -> list[system.Finding]:
    place = unit / "changed.toml"
    text = (unit / "altd.toml").read_text()
    assert old in text
    place.write_text(text.replace(old, by))
    return list(system.calibration(load_config(place), place))


class TestCalibration:
    def test_that_of_the_unit(self, unit: Path) -> None:
        known = load_calibration(unit / "cal.json")
        real = tuple(
            replace(
                target, origin=Origin.CAMERA, flat=target.flat and replace(target.flat, origin=Origin.CAMERA)
            )
            for target in known.targets
        )
        save_calibration(replace(known, targets=real), unit / "real.json")
        (finding,) = examined(unit, "cal.json", "real.json")
        assert finding.verdict is Verdict.GOOD
        assert "real.json fits" in finding.text

    @pytest.mark.parametrize(
        ("old", "by", "verdict", "words", "mend"),
        [
            ("window", "window", Verdict.WARNING, ("cal.json fits", "SIMULATED"), ""),
            ('serial = "', 'serial = "OTHER-', Verdict.ERROR, ("cal.json",), "altd calibrate"),
            ("cal.json", "none.json", Verdict.ERROR, ("none.json",), ""),
        ],
        ids=["simulated", "of another unit", "not there"],
    )
    def test_one_that_is_simulated_of_another_unit_or_not_there(
        self, unit: Path, old: str, by: str, verdict: Verdict, words: tuple[str, ...], mend: str
    ) -> None:
        (finding,) = examined(unit, old, by)
        assert finding.verdict is verdict
        assert all(word in finding.text for word in words)
        assert mend in finding.remedy

    def test_one_that_every_user_may_write(self, unit: Path) -> None:
        (unit / "cal.json").chmod(0o646)
        try:
            (finding,) = examined(unit, "cal.json", "cal.json")
        finally:
            (unit / "cal.json").chmod(0o644)
        assert finding.verdict is Verdict.ERROR
        assert f"chmod o-w {unit / 'cal.json'}" in finding.text

    def test_a_recording_that_is_not_there(self, unit: Path) -> None:
        findings = examined(unit, "/scan", "/nowhere")
        assert findings[0].subject == "recording"
        assert findings[0].verdict is Verdict.ERROR


def test_the_lines_say_how_many() -> None:
    assert in_lines(
        [
            Finding.error("a", "is off", "switch a on"),
            Finding.warning("b", "is slow"),
            Finding.good("c", "is on"),
        ]
    ) == [
        "ERROR   a: is off",
        "        fix: switch a on",
        "warning b: is slow",
        "good    c: is on",
        "1 error, 1 warning, 1 good",
    ]


class TestCommand:
    def test_it_ends_with_1_when_something_is_wrong(self, unit: Path, tmp_path: Path) -> None:
        more = '\n[[serial]]\ndevice = "/dev/ttyUSB77"\nspeaks = "console"\n'
        config = write_config(tmp_path / "altd.toml", unit / "cal.json", unit / "scan", more)
        outcome = altd_here("doctor", "--config", config)
        assert outcome.status == 1
        assert outcome.err == ""
        assert "ERROR   serial /dev/ttyUSB77: does not exist" in outcome.out

    def test_it_ends_with_0_when_nothing_is(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        from altd.cli.main import main

        only = {"all": lambda: iter([Finding.good("all", "is well")])}
        monkeypatch.setattr(checks, "_checks", lambda *_: only)
        assert main(["doctor"]) == 0
        assert capsys.readouterr().out == "good    all: is well\n0 errors, 0 warnings, 1 good\n"

    def test_without_a_config_it_looks_at_the_computer(self) -> None:
        outcome = altd_here("doctor")
        assert outcome.status in (0, 1)
        assert outcome.err == ""
        assert "library gpiod" in outcome.out

    def test_a_config_that_cannot_be_read_is_a_bad_argument(self, tmp_path: Path) -> None:
        line = refusal(altd_here("doctor", "--config", tmp_path / "none.toml"))
        assert line.startswith("altd doctor: ")
        assert altd_here("doctor", "nonsense").status == 2

    def test_a_check_that_fails_hides_no_other(self, monkeypatch: pytest.MonkeyPatch, tree: Tree) -> None:
        def breaks(_: object) -> None:
            raise ZeroDivisionError("a strange computer")

        monkeypatch.setattr(system, "disk", breaks)
        findings = checks.examine(None, tree.machine)
        words = "could not be checked: ZeroDivisionError: a strange computer"
        finding = says(findings, Verdict.WARNING, words)
        assert finding.subject == "disk"
        assert any(other.subject == "clock" for other in findings)
