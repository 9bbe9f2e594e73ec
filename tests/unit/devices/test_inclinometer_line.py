"""The line to an inclinometer when it does worse than be silent or damaged."""

import os
import threading
from itertools import count
from pathlib import Path

import pytest
import serial
from support.inclinometer import answering, settings
from support.modbus_rtu_wire import frame
from support.wire import Wire

from altd.acquisition.inclination.judging import InclinationJudge
from altd.devices.inclinometer import driver
from altd.devices.inclinometer.driver import Line
from altd.devices.inclinometer.registers import BALLUFF
from altd.ports import InclinometerDisturbedError, InclinometerNotFoundError
from hw_sim.inclinometer import Inclinometer


def test_a_line_that_never_falls_silent_is_given_up_in_time() -> None:
    """A byte every 10 ms keeps each gap short and would take three seconds to be too much."""
    ending, sent = threading.Event(), 0
    wire = Wire.laid()

    def babble() -> None:
        nonlocal sent
        while not ending.wait(0.01):
            wire.send(b"\x01")
            sent += 1

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        with pytest.raises(InclinometerDisturbedError, match="damaged answer"):
            settings(wire.device).inclinometer().open()
        assert sent < 256  # more would be too much
    finally:
        ending.set()
        thread.join()
        wire.hang_up()


@pytest.mark.parametrize(("asleep_s", "first_bytes"), [(0.04, 4), (1.0, 7)])
def test_an_answer_that_waits_while_the_machine_is_busy_is_read_to_its_end(
    asleep_s: float, first_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It sleeps at each step: longer than a gap or an answer may take, but the line was not silent."""
    answer, times_s = frame(b"\x04\x02\x01\x2c", 1), count(0, asleep_s)
    rest = [answer[:first_bytes], answer[first_bytes:]]

    class Port:
        in_waiting = 0

        def reset_input_buffer(self) -> None:
            pass

        def fileno(self) -> int:
            return sink.fileno()

        def read(self, size: int) -> bytes:
            return rest.pop(0) if rest else b""

    monkeypatch.setattr(driver, "open_serial", lambda *_, **__: Port())
    monkeypatch.setattr(driver.time, "monotonic", lambda: next(times_s))
    with Path(os.devnull).open("wb") as sink:
        assert Line(settings("/dev/any"), 19200, 1).ask(4, 0, 1) == [300]


def test_a_process_that_sleeps_while_it_asks_has_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial's own clock jumps by a second at each look: its write would call the port gone."""
    times_s = count(0.0, 1.0)
    monkeypatch.setattr(driver, "_ANSWER_TIMEOUT_S", 30.0)
    with answering(lambda request: frame(b"\x04\x02\x01\x2c", 1)) as wire:
        line = Line(settings(wire.device), 19200, 1)
        monkeypatch.setattr(serial.serialutil.Timeout, "TIME", lambda *_: next(times_s))
        assert line.ask(4, 0, 1) == [300]


@pytest.mark.parametrize("taken", [None, 3])
def test_a_line_that_does_not_take_a_request_is_reported_at_once(
    taken: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the kernel does where its buffer is full: a pty's empties itself, at a time of its own."""

    def write(_file: int, _request: bytes) -> int:
        if taken is None:
            raise BlockingIOError
        return taken

    line = Line(settings(Wire.laid().device), 19200, 1)
    monkeypatch.setattr(driver.os, "write", write)
    with pytest.raises(InclinometerNotFoundError, match="accepts no request"):
        line.ask(4, 0, 1)


def test_a_line_that_is_an_answer_behind_gives_no_believed_roll(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where each answer comes twice: then that of the question before is the first to be heard."""
    monkeypatch.setattr(
        driver, "_ANSWER_TIMEOUT_S", 30.0
    )  # each question gets an answer, on a busy machine late
    sensor = Inclinometer.balluff()
    sensor.roll_deg = -3.0
    is_behind, before = False, b""

    def answer(request: bytes) -> bytes:
        nonlocal before
        late, before = before, frame(sensor.response(request[1:-2]), 1)
        return late if is_behind else before

    judge = InclinationJudge(settings("/dev/any"), BALLUFF.accuracy)
    with answering(answer) as wire:
        inclinometer = settings(wire.device).inclinometer()
        inclinometer.open()
        good = [judge.roll(inclinometer.read()) for _ in range(15)]  # the settings were just read
        is_behind = True
        wrong = [judge.roll(inclinometer.read()) for _ in range(6)]
        with pytest.raises(InclinometerDisturbedError, match="an answer to another question"):
            inclinometer.read()
        with pytest.raises(InclinometerDisturbedError):
            inclinometer.read()
        is_behind = False
        again = inclinometer.read()
        inclinometer.close()
    sensor.unplug()
    assert good[-1].value == pytest.approx(-3.0, abs=0.1)
    assert all(said.value is None or said.value == pytest.approx(-3.0, abs=0.1) for said in wrong)
    assert again.roll_deg == pytest.approx(-3.0, abs=0.1)
