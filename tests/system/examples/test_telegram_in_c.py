"""The parser in C, by the table of cases and beside that in Python; and the program that shows its use."""

import os
import subprocess
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.played_unit import PlayedUnit, playing
from support.telegram_cases import C, ReaderInC, check, compile_c, read_by_python, variants, wire
from support.wire import socat_line

FOREIGN = "refused: of another unit"
SHOWN = {
    "live 160": "x 10.012 mm, y 4.987 mm, yaw 1.1459 deg, pitch -1.7184 deg, 0.52 s old",
    "live 160:MQC": "refused: not newer",
    "simulated": "STOP: not live, but played or simulated",
    "live 162": "x 10.014 mm, y 4.987 mm, yaw 1.1459 deg, pitch -1.7184 deg, 0.52 s old",
    "live 163:MQ": "refused: without the third sentence",
    "blocked 180": "STOP: the unit says front_spot_missing+rear_spot_missing",
    "restarted 5": "STOP: the unit was restarted: start this program again",
}
"""The program's output for each telegram."""


def test_every_case_gives_what_the_table_says_and_the_same_as_in_python(tmp_path: Path) -> None:
    reader = ReaderInC(tmp_path)
    tried = 0
    for variant in variants():
        result = reader.read(variant)
        check(variant, result)
        assert result == read_by_python(variant, 1000)
        tried += 1
    assert tried > 7000
    reader.end()


class Program:
    """``read_telegram`` as it runs."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        self._output = process.stdout

    def until(self, text: str, send: tuple[int, bytes] | None = None) -> list[str]:
        """The lines up to the first with a text; ``send``: to this descriptor these bytes, until it comes."""
        shown, deadline = "", time.monotonic() + 60
        while text not in shown.rpartition("\n")[0]:
            assert time.monotonic() < deadline, shown
            if send is not None:
                os.write(*send)
            shown += (self._output.read() or b"").decode()
            time.sleep(0.01)
        return shown.splitlines()


@contextmanager
def running(folder: Path, device: str | Path, serial: str) -> Iterator[Program]:
    program = folder / "read_telegram"
    compile_c(C / "read_telegram.c", C / "altd_telegram.c", "-o", program)
    with subprocess.Popen([program, device, serial, "115200"], stdout=subprocess.PIPE) as process:
        try:
            yield Program(process)
        finally:
            process.kill()


@pytest.mark.waits
def test_the_program_shows_values_and_stops_for_each_reason(tmp_path: Path) -> None:
    assert (C / "read_telegram.c").read_text().count("\n") < 80
    far, near = os.openpty()
    tty.setraw(near)
    with running(tmp_path, os.ttyname(near), "ALT-0007") as program:
        program.until(FOREIGN, (far, wire("other unit")))  # it has opened the port
        for telegram in SHOWN:
            os.write(far, wire(telegram))
        shown = program.until("STOP: no valid telegram for 3 s", (far, wire("other unit")))
        assert [line for line in shown if line != FOREIGN][:-1] == list(SHOWN.values())
        os.close(near)
        os.close(far)
        assert program.until("gone")[-1] == "STOP: the port is gone"
        assert program.process.wait(20) == 1


def test_the_program_never_takes_what_a_daemon_plays_and_finds_its_restart(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    with socat_line(tmp_path) as (near, far, _), running(tmp_path, far, "TEST-1") as program:
        port = f'[[serial]]\ndevice = "{near}"\nspeaks = "telegram"\nbaud = 115200\nchecked = true\n'
        for expected in ("not live, but played or simulated", "the unit was restarted"):
            with playing(played_unit, tmp_path, subprocess.DEVNULL, more=port + "interval_s = 0.1\n"):
                shown = program.until(expected)
                assert not any(line.startswith("x ") for line in shown)
