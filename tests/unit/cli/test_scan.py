"""``altd scan`` and the scan of the turned unit that it asks for; the scanner is replaced."""

import io
from pathlib import Path
from typing import Any

import pytest
from support.unit_toml import write_config

from altd.cli import scan
from altd.cli.main import main
from altd.config import Config


class Console(io.StringIO):
    """Input of a person, or of a script if it is no terminal."""

    def __init__(self, text: str, is_terminal: bool) -> None:
        super().__init__(text)
        self.isatty = lambda: is_terminal  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("options", "status", "answer", "is_terminal", "scans", "is_asked"),
    [
        ([], 0, "\n", True, [(0, "scan"), (180, "scan-turned")], True),
        ([], 0, "n\n", True, [(0, "scan")], True),
        ([], 0, "", True, [(0, "scan")], True),
        ([], 0, "\n", False, [(0, "scan")], True),
        ([], 1, "\n", True, [(0, "scan")], False),
        (["--no-turn"], 0, "\n", True, [(0, "scan")], False),
        (["--turned"], 0, "\n", True, [(180, "scan")], False),
    ],
)
def test_the_turned_scan_is_asked_for_and_no_turn_is_a_choice(
    options: list[str],
    status: int,
    answer: str,
    is_terminal: bool,
    scans: list[tuple[int, str]],
    is_asked: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    made: list[tuple[int, str]] = []

    def scanner(config: Config, _place: Path, folder: Path, *_: Any) -> None:
        made.append((config.scan.turned_deg, folder.name))

    monkeypatch.setattr("altd.app.record.scanner_of", scanner)
    monkeypatch.setattr(scan, "run_scan", lambda *_: status)
    monkeypatch.setattr("sys.stdin", Console(answer, is_terminal))
    config = write_config(tmp_path / "altd.toml", tmp_path / "none.json", tmp_path / "rec")
    words = ["scan", *options, "--config", str(config), "-o", str(tmp_path / "scan")]
    assert main(words) == status
    assert made == scans
    assert ("turn the unit by 180°" in capsys.readouterr().err) is is_asked
