"""The Modbus clients of ``examples/`` and the real daemon, which plays a recording."""

import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import example_clients as clients
from support.example_clients import Verdict
from support.played_unit import PlayedUnit, playing
from support.scripted_unit import SERIAL, Wire, answering, block

GOOD, LIMIT_MS = "good", 30_000.0
TRUTH = pytest.approx((10.0, 5.0, 1.1458, -1.7184), abs=0.02)


@pytest.mark.parametrize("language", ["python", "c"])
def test_an_answer_that_never_ends_is_given_up(language: str, tmp_path: Path) -> None:
    """Else the last values would be in use for as long as bytes come: 34 s here, in place of one."""
    words = clients.command(language, tmp_path)
    with (
        answering([block(2), Wire.TRICKLE, block(3)]) as port,
        clients.running([*words, "127.0.0.1", port, SERIAL, 10_000]) as (_, told),
    ):
        assert next(told)[0] == GOOD
        begun_s = time.monotonic()
        assert next(told)[0] == "no answer"
        assert time.monotonic() - begun_s < 15
        assert next(told)[0] == GOOD


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_program_follows_a_unit_that_stops_and_restarts(
    played_unit: PlayedUnit, tmp_path: Path, language: str
) -> None:
    words = clients.command(language, tmp_path)
    with playing(played_unit, tmp_path, subprocess.DEVNULL) as daemon:
        daemon.wait_until_valid()
        arguments = [*words, "127.0.0.1", daemon.modbus, "TEST-1", 3000]
        rehearsing = clients.running([*arguments, "--rehearsal"])
        with rehearsing as (process, told), clients.running(arguments) as (_, not_told):
            assert _first_after("no answer", not_told) == ("not live", None)
            assert _first_good(told, process) == TRUTH
            daemon.process.kill()
            daemon.process.wait()
            assert ("no answer", None) in told, "else the values stay in use for ever"
            with subprocess.Popen(daemon.process.args, stderr=subprocess.DEVNULL) as again:
                try:
                    assert _first_after("no answer", told) == ("restarted", None)
                    assert _first_good(told, process) == TRUTH
                finally:
                    again.kill()


def _first_good(told: Iterator[Verdict], process: subprocess.Popen[str]) -> tuple[float, ...] | None:
    """The operator acknowledges each time that he sees a unit that was restarted or silent."""
    for fault, values in told:
        if fault == GOOD:
            return values
        if fault in ("restarted", "silent"):
            process.send_signal(signal.SIGUSR1)
    raise AssertionError("the program has ended")


def _first_after(fault: str, told: Iterator[Verdict]) -> Verdict:
    return next(verdict for verdict in told if verdict[0] != fault)
