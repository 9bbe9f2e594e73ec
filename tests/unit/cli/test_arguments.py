"""Wrong arguments: one line that names the argument and what is possible; none at all: what there is."""

import inspect
import json
import math
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.places import ROOT

from altd.cli import main as cli
from altd.config import LiveCameraSettings, Measuring, Scan
from altd.devices.hwmon import HwmonThermometerSettings
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M
from examples.python.altd_telegram import Reader
from hw_sim.__main__ import command_parser
from hw_sim.__main__ import main as simulate

REPLAY = ("replay", "rec", "--calibration", "cal.json")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("rpelay",), "altd: unknown command 'rpelay'; possible: run, calibrate, replay, "),
        (("rpelay",), "; did you mean `replay`?"),
        (("--confg", "x", "run"), "unknown argument --confg"),
        ((*REPLAY, "--window", "0"), "altd replay: --window: '0' is not a whole number from 1 to 1000"),
        ((*REPLAY, "--window", "9" * 5000), " is not a whole number from 1 to 1000"),
        ((*REPLAY, "--window", "two"), "altd replay: --window: 'two' is not a whole number from 1 to 1000"),
        ((*REPLAY, "--every", "1.5"), "altd replay: --every: '1.5' is not a whole number from 1 to 1000"),
        ((*REPLAY, "--window"), "altd replay: --window: one value must follow; usage: altd replay "),
        ((*REPLAY, "--windw", "3"), "altd replay: --windw: unknown argument; possible: --help, "),
        ((*REPLAY, "--windw", "3"), "; did you mean `--window`?"),
        ((*REPLAY, "more"), "altd replay: 'more' is unexpected; usage: altd replay "),
        (("replay",), "altd replay: missing: RECORDING, --calibration; usage: altd replay "),
        (
            ("replay", "rec", "--calibrtion", "x"),
            "unknown argument --calibrtion; did you mean `--calibration`?",
        ),
        (("record", "-o", "x", "--seconds", "-1"), "--seconds: '-1' is not a number of seconds"),
        (("record", "-o", "x", "--seconds", "nan"), "--seconds: 'nan' is not a number of seconds"),
        (
            ("record", "-o", "x", "--seconds", "1", "--kind", "flta"),
            "--kind: 'flta' is not possible; possible: ",
        ),
        (
            ("record", "-o", "x", "--seconds", "1", "--plate", "7,5"),
            "--plate: '7,5' is not a plate; possible",
        ),
        (
            ("record", "-o", "x", "--seconds", "1", "--plate", "7,5,25,2"),
            "'7,5,25,2' is not a plate; possible",
        ),
        (("record", "-o", "x", "--seconds", "1", "--plate", "7,5,25,1,1"), "is not a plate; possible"),
        (("record", "-o", "x", "--seconds", "1", "--shift=6"), "'6' is not a shift; possible: two numbers"),
        (("record", "-o", "x", "--seconds", "1", "--shift=nan,0"), "'nan,0' is not a shift; possible: two"),
        (("record", "-o", "x", "--seconds", "1", "--placed", "1,2"), "'1,2' is not a placing; possible"),
        (("record", "-o", "x", "--seconds", "1", "--plate", "3,5,25"), "'3,5,25' is not a plate; possible"),
        (("record", "-o", "x", "--seconds", "1", "--plate", "7,5,nan"), "'7,5,nan' is not a plate; possible"),
        (("record", "-o", "x", "--seconds", "1", "--beam", "0"), "'0' is not a diameter up to 50 mm"),
        (("lamps", "offf"), "'offf' is not possible; possible: off, on, test, stopped; did you mean `off`?"),
        (
            ("check-config", "a.toml", "--config", "b.toml"),
            "altd check-config: --config: not allowed with argument FILE",
        ),
        (("devices", "\x1b[2J"), "'\\x1b[2J' is unexpected"),
        (("selfcheck", "rec"), "altd selfcheck: rec: missing: --calibration FILE, to compare"),
        (("selfcheck", "rec", "--config", "altd.toml"), "altd selfcheck: --config: asks the running"),
        (("selfcheck", "--calibration", "cal.json"), "altd selfcheck: --calibration: missing: RECORDING,"),
        (
            ("selfcheck", "rec", "--calibration", "cal.json", "--config", "altd.toml"),
            "altd selfcheck: --config: asks the running daemon: it cannot be combined with RECORDING",
        ),
    ],
)
def test_a_wrong_argument_is_one_line(
    arguments: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert line in said.err
    assert said.err.count("altd selfcheck: ") <= 1


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("dmeo",), "unknown command 'dmeo'; possible: scan, flat, "),
        (("scan", "--seed", "x", "-o", "y"), "--seed: 'x' is not a whole number from 0 on"),
        (("scan", "--seed", "9" * 5000, "-o", "y"), " is not a whole number from 0 on"),
        (("gige", "--bits", "9"), "--bits: 9 is not possible; possible: 8, 10, 12, 16"),
        (("gige", "--bits", "x"), "--bits: 'x' is not a whole number"),
        (("gige", "--pose", "0", "0", "0", "up"), "--pose: 'up' is not a number"),
        (("gige", "--fps", "0"), "--fps: '0' is not a number from 1 to 200"),
        (("demo", "--http-prt", "1"), "--http-prt: unknown argument"),
        (("demo", "--mqtt", "a b"), "--mqtt: 'a b' is not a broker; possible: HOST or HOST:PORT"),
        (("demo", "--mqtt", "plant:0"), "'plant:0' is not a broker"),
    ],
)
def test_so_it_is_with_the_simulator(
    arguments: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert simulate(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.startswith("python -m hw_sim")
    assert line in said.err


@pytest.mark.parametrize(
    ("module", "first"), [("altd.cli", "altd doctor"), ("hw_sim", "python -m hw_sim demo")]
)
def test_without_a_command_it_shows_what_there_is_and_what_to_try_first(module: str, first: str) -> None:
    outcome = altd_here(module=module)
    assert (outcome.status, outcome.out) == (2, "")
    text = outcome.err
    assert text.index("commands:") < text.index("first steps:") < text.rindex(f"  {first} ")
    asked = altd_here("--help", module=module)
    assert (asked.status, asked.out, asked.err) == (0, text, "")


Told = Callable[[Path, Sequence[str]], str]
CONFIGURED = ("run", "record -o {new} --seconds 1", "scan -o {new}", "lamps off", "check-config")


class TestWithoutAConfig:
    """``DEFAULT_CONFIG`` is where the service has its own; here the constant is another."""

    @pytest.fixture
    def told(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Told:
        """The complaint about bad arguments where that is the service's own config."""

        def told(installed: Path, arguments: Sequence[str]) -> str:
            monkeypatch.setattr(cli, "DEFAULT_CONFIG", installed)
            assert cli.main(arguments) == 2
            return capsys.readouterr().err

        return told

    @pytest.mark.parametrize("command", [*CONFIGURED, "doctor"])
    def test_the_service_s_own_is_taken_where_it_is(self, command: str, tmp_path: Path, told: Told) -> None:
        installed = tmp_path / "altd.toml"
        installed.write_text("[unit]\ncolour = 3\n")
        line = f"{installed}: line 2, column 1: unit.colour: there is no such key"
        assert line in told(installed, command.format(new=tmp_path / "new").split())

    @pytest.mark.parametrize("command", CONFIGURED)
    def test_where_there_is_none_that_is_said(self, command: str, tmp_path: Path, told: Told) -> None:
        name, *arguments = command.format(new=tmp_path / "new").split()
        said = f"altd {name}: missing: --config FILE, because there is no {tmp_path}/none.toml\n"
        assert told(tmp_path / "none.toml", [name, *arguments]) == said

    @pytest.mark.parametrize("option", [(), ("--config",)])
    def test_one_that_is_named_counts(self, option: tuple[str, ...], tmp_path: Path, told: Told) -> None:
        (tmp_path / "altd.toml").write_text("[unit]\n")
        arguments = ["check-config", *option, str(tmp_path / "other.toml")]
        assert "other.toml: No such file" in told(tmp_path / "altd.toml", arguments)


@pytest.mark.parametrize(("name", "serial"), [("live", "ALT-0001"), ("desk", "DESK-1")])
def test_the_shipped_configs_pass_their_own_check(name: str, serial: str) -> None:
    """In a fresh clone, without a calibration beside it; and that is reported."""
    shipped = ROOT / "config" / f"{name}.toml"
    outcome = altd_here("check-config", shipped)
    assert (outcome.status, outcome.err) == (0, "")
    good, missing = outcome.out.splitlines()
    assert good == f"{shipped}: good: unit {serial}, 2 targets"
    assert missing.startswith(f"{shipped}: unit.calibration: ")
    refused = altd_here("run", "--config", shipped)
    assert refused.status == 2
    assert refused.err.splitlines() == [f"altd run: {missing}"]


def test_settings_with_a_slip_in_one_place_have_one_error(tmp_path: Path) -> None:
    shipped = (ROOT / "config" / "live.toml").read_text()
    wrong = tmp_path / "altd.toml"
    wrong.write_text(shipped.replace('camera = "rear"', 'camera = "raer"'))
    line = refusal(altd_here("check-config", "--config", wrong))
    assert line.endswith('there is no table [cameras.raer]; possible: "front", "rear"; did you mean `rear`?')
    wrong.write_text(f'{shipped}\n[serial]\ndevice = "/dev/ttyS0"\n')
    line = refusal(altd_here("check-config", wrong))
    assert line.endswith("serial: there may be several of this table; write `[[serial]]`")


@pytest.mark.parametrize(("z_mm", "is_usual"), [("28.0", False), ("100.0", True), ("2800.0", False)])
def test_an_unusual_distance_of_the_targets_is_a_remark(tmp_path: Path, z_mm: str, is_usual: bool) -> None:
    wrong = tmp_path / "altd.toml"
    wrong.write_text((ROOT / "config" / "live.toml").read_text().replace("z_mm = 280.0", f"z_mm = {z_mm}"))
    outcome = altd_here("check-config", wrong)
    remark = f"{wrong}: first and last target are {float(z_mm):g} mm apart: check z_mm"
    assert outcome.status == 0
    assert (remark in outcome.out.splitlines()) is not is_usual


def test_a_service_does_not_rehearse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    line = refusal(altd_here("run", "--rehearsal", "--config", tmp_path / "none.toml"))
    assert line == "altd run: --rehearsal: not possible in a service; start `altd run` by hand"


PARSERS = {"altd": cli.command_parser(), "hw_sim": command_parser()}
_COMMAND = re.compile(
    r"(?:\S*/)?(?:python3? -m )?(altd|hw_sim)(?:\.cli)? (?!\S+:|--version|\d)([^<>]*)(?:[<>].*)?"
)
_PAGES = [ROOT / "README.md", *(path for path in ROOT.glob("docs/*.md") if path.name != "commands.md")]


def _documented(path: Path) -> Iterator[tuple[str, list[str]]]:
    """The commands in the code blocks of a page: of which program, and its arguments."""
    is_fenced = False
    for line in path.read_text().split("\n"):
        is_fenced ^= line.startswith("```")
        if is_fenced or line.startswith("    "):
            for part in re.split(r" && | \| ", line.split("  #")[0]):
                if found := _COMMAND.fullmatch(part.strip().removeprefix("sudo ")):
                    yield found[1], shlex.split(found[2])


@pytest.mark.parametrize("path", _PAGES, ids=lambda path: path.name)
def test_the_pages_have_commands_that_the_parsers_accept(path: Path) -> None:
    for program, arguments in _documented(path):
        options, unknown = PARSERS[program].parse_known_args(arguments)
        assert options.command, arguments
        assert not unknown, arguments


def test_the_tutorial_has_commands_of_both_programs() -> None:
    programs = [program for program, _ in _documented(ROOT / "docs" / "first-hour.md")]
    assert programs == ["hw_sim", "altd", "altd", "altd", "hw_sim", "altd", "hw_sim"]


def _rows(page: str) -> dict[str, str]:
    """The tables of a page: the first cell and the second one."""
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|", (ROOT / page).read_text(), re.M)
    return dict(rows)


def test_the_specification_has_the_ranges_rates_and_limits_of_the_code() -> None:
    rows, measuring, scan = _rows("docs/specification.md"), Measuring(), Scan()
    fps = LiveCameraSettings.model_fields["fps"].default
    width, height = ((nodes - 1) * scan.pitch_mm for nodes in (scan.columns, scan.rows))
    assert f"{width:g} × {height:g} mm" in rows["`x`, `y`"]
    for name, limit in (("yaw", MAX_YAW_MM_PER_M), ("pitch", MAX_PITCH_MM_PER_M)):
        degrees = math.degrees(math.atan(limit / 1000))
        assert rows[f"`{name}`"].startswith(f"±{limit:g} mm/m (±{degrees:.2f}°)")
    assert rows["measurements"] == f"{fps / measuring.every:g} per second"
    assert rows["one measurement"] == f"mean of {measuring.window} exposures, {measuring.window / fps:g} s"
    assert rows["normal `age`"].startswith(f"{measuring.window / fps / 2:.1f} to ")
    assert rows["a silent camera makes it invalid after"] == f"{measuring.silent_after_s:g} s"
    withdrawn = rows["value withdrawn when its last exposure is older than"]
    assert withdrawn == f"{measuring.stale_after_s:.1f} s"
    fields = HwmonThermometerSettings.model_fields
    coldest, warmest = (fields[f"{end}_celsius"].default for end in ("min", "max"))
    outside = rows["`too_cold`, `too_hot` of camera and thermometer"]
    assert outside == f"below −{-coldest:g} °C, above +{warmest:g} °C"
    readme = _rows("README.md")
    angles = f"±{MAX_YAW_MM_PER_M:g}, ±{MAX_PITCH_MM_PER_M:g} mm/m"
    assert readme["range"] == f"x, y: {width:g} × {height:g} mm; yaw, pitch: {angles}"
    assert readme["measurements"] == f"{rows['measurements']}, each the mean of one second, 0.5 to 0.6 s old"


def test_the_readme_states_the_combined_uncertainty_of_the_budget() -> None:
    """The larger one of both units; a turned scan replaces the beam's tilt by 0.0003° (docs/budget.md)."""
    study = (ROOT / "docs" / "studies" / "budget.md").read_text()
    once, twice = np.zeros(4), np.zeros(4)
    for unit in ("simulated", "rendered"):
        terms = {
            name: np.array([float(value) for value in values.split("|")])
            for name, values in re.findall(rf"^\|{unit}: (.+?) *\|(.+)\|$", study, re.M)
        }
        combined, tilt = terms["**combined, linear**"], terms["calibrating beam against the normal"]
        assert tilt.tolist() == pytest.approx([0.0, 0.0, 0.017, 0.017], abs=3e-4)  # 0.3 mm/m
        once = np.maximum(once, combined)
        twice = np.maximum(twice, np.sqrt(combined**2 - tilt**2 + (tilt > 0) * 0.0003**2))
    page = (ROOT / "README.md").read_text()
    stated = re.findall(r"^\| (?:one scan|the same).+\| ([\d.]+) mm \| ([\d.]+)° \|$", page, re.M)
    figures = [[f"{each[:2].max():.3f}", f"{each[2:].max():.3f}"] for each in (once, twice)]
    assert [list(row) for row in stated] == figures


def test_the_recommended_limits_of_age_are_those_of_the_readers() -> None:
    rows = _rows("docs/specification.md")
    limit_s = inspect.signature(Reader).parameters["max_age_s"].default
    assert rows["recommended limit of `age`"].startswith(f"{limit_s:.1f} s; ")
    limits = ("http", f"{limit_s:.1f}"), ("modbus", f"{1000 * limit_s:g} ms"), ("telegram", "1000")
    for page, limit in limits:
        text = (ROOT / "docs" / f"{page}.md").read_text()
        assert f"use it up to {limit}\n([specification](specification.md#latency-and-age))" in text
    tab = json.loads((ROOT / "examples/node_red/flow.json").read_text())[0]
    waiting_s = next(float(each["value"]) for each in tab["env"] if each["name"] == "LIMIT_MS") / 1000
    assert rows["the same for a program that waits for the unit"].startswith(f"{waiting_s:g} s (")


def test_measured_figures_are_those_of_the_pages_that_explain_them() -> None:
    sources = "".join((ROOT / f"docs/{name}.md").read_text() for name in ("accuracy", "studies/fig-3.17"))
    figures = re.findall(r"\b(?:0\.\d{4}|\d+,\d{3})\b", (ROOT / "docs/specification.md").read_text())
    assert len(figures) > 12
    assert [figure for figure in figures if figure not in sources] == []
