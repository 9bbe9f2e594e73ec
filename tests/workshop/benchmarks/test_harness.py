"""The harness of the benchmarks: child processes end in every case, wrong arguments are one line."""

import re
import sys
from pathlib import Path

import pytest

from altd.errors import BadInputError
from benchmarks import harness
from benchmarks.harness import Child, Columns, Parser, aligned, child, markdown_table, module_command

DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('deaf', flush=True)"
WORKS = "; time.sleep(600)"


def test_a_child_ends_when_the_block_raises() -> None:
    started: list[Child] = []

    def fail() -> None:
        with child(["/bin/cat"], stdin=-1) as running:
            started.append(running)
            raise KeyError("a pair")

    with pytest.raises(KeyError, match="a pair"):
        fail()
    assert started[0].process.returncode == -15


def test_a_child_that_ignores_the_signal_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harness, "_END_TIMEOUT_S", 0.2)
    with child([sys.executable, "-c", DEAF + WORKS]) as running:
        running.await_text("deaf")
    assert running.process.returncode == -9


def test_the_output_of_a_child_that_ends_early_is_in_the_error(tmp_path: Path) -> None:
    said = "ended with status 1; its output: 'no camera"
    with (
        child([sys.executable, "-c", "raise SystemExit('no camera')"], tmp_path / "log") as running,
        pytest.raises(RuntimeError, match=said),
    ):
        running.await_text("ready")


def test_the_output_of_a_child_that_has_failed_is_beside_any_error() -> None:
    error = KeyError("a pair")
    with child([sys.executable, "-c", "raise SystemExit('no camera')"]) as running:
        running.process.wait()
        running.explain(error)
    assert "its output: 'no camera" in error.__notes__[0]


def test_a_child_reports_when_its_standard_input_ends() -> None:
    code = "import sys; print('ready', flush=True); sys.stdin.read(); print('done')"
    with child([sys.executable, "-c", code], stdin=-1) as running:
        running.await_text("ready\n")
        assert running.result() == "ready\ndone\n"
    assert module_command("altd.cli", 1) == [sys.executable, "-m", "altd.cli", "1"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--seconds", "0"], "--seconds: '0' is not a number above 0"),
        (["--seconds", "nan"], "--seconds: 'nan' is not a number above 0"),
        (["--units", "two"], "--units: 'two' is not a whole number from 1"),
        (["--share", "1.5"], "--share: '1.5' is not a number from 0 to 1"),
        (["--only", "beam,lamp"], "--only: unknown 'lamp'; known are beam, frame"),
    ],
)
def test_a_wrong_argument_is_one_line(
    given: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = Parser("benchmarks.toy", "A toy.")
    parser.number("--seconds", 60.0, "of the run")
    parser.number("--share", 0.2, "of the pairs", "SHARE", (0.0, 1.0))
    parser.count("--units", 20, "that are live")
    parser.names("--only", ("beam", "frame"), "parts")
    parser.json()
    options = parser.parse_args(["--seconds", "2.5", "--only", "beam"])
    assert (options.seconds, options.share, options.units, options.only) == (2.5, 0.2, 20, ("beam",))
    assert "of the run (default 60)" in parser.format_help()
    with pytest.raises(SystemExit):
        parser.parse_args(given)
    assert capsys.readouterr().err == f"python -m benchmarks.toy: {said}\n"
    with pytest.raises(BadInputError, match="/dev/null: is a device"):
        parser.parse_args(["--json", "/dev/null"])


def test_tables_have_the_places_of_their_formats() -> None:
    table = Columns("stage:<8", "median µs:>11.1f", "more:>+8.3f", "aim:")
    assert table.head == "stage     median µs    moreaim"
    assert table.row("search", 12.345, -0.5, "  < 40") == "search         12.3  -0.500  < 40"
    assert table.row("aim", None, "none") == "aim                    none"
    rows = [("way", "runs"), ("clean", "7")]
    assert list(aligned(rows)) == ["way    runs", "clean     7"]
    assert markdown_table(rows[0], rows[1:]) == "|way|runs|\n|---|---:|\n|clean|7|"


def test_the_machine_is_named() -> None:
    assert re.fullmatch(r"\d+", harness.machine()["cores"])
