"""The port on a pseudo terminal: whole or not at all, never blocking, loud when it is gone."""

import asyncio
import errno
import fcntl
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import serial
from support.wire import Wire, socat_line

from altd.config import SerialPortSettings
from altd.serial_line.opening import LineSettings, close_serial, has_hardware, open_serial
from altd.serial_port import port
from altd.serial_port.port import describe, opened, seconds_on_line

GONE = "the port is gone"


async def test_bytes_go_both_ways(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as line:
        assert line.write(b"out")
        assert await wire.receive(lambda data: data == b"out")
        wire.send(b"in")
        assert await line.read() == b"in"


async def test_a_real_serial_client_at_the_far_end(tmp_path: Path) -> None:
    with socat_line(tmp_path) as (near, far, socat):
        settings = SerialPortSettings(device=near, baud=115200, parity="even", stop_bits=2)
        async with opened(settings, limit=100, fresh=True) as line:
            with serial.Serial(str(far), 115200, timeout=60) as client:
                line.write(b"$PALT\r\n")
                assert await asyncio.to_thread(client.readline) == b"$PALT\r\n"
                client.write(b"help\r")
                assert await line.read() == b"help\r"
                socat.kill()
                with pytest.raises(OSError, match=GONE):
                    await asyncio.wait_for(line.read(), 60)


async def test_reading_ends_when_the_pause_is_over(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as line:
        assert await line.read(until=asyncio.ensure_future(asyncio.sleep(0.01))) == b""


async def test_what_does_not_fit_is_refused_whole_and_never_blocks(wire: Wire) -> None:
    """No reader: the kernel's buffer fills up, then one telegram waits, then all are refused."""
    telegram = b"x" * 98 + b"\r\n"
    async with opened(wire.settings(), limit=150, fresh=True) as line:
        accepted = 0
        slowest_s = 0.0
        for _ in range(2000):
            started = time.perf_counter()
            accepted += line.write(telegram)
            slowest_s = max(slowest_s, time.perf_counter() - started)
        assert accepted < 2000
        assert slowest_s < 25.0, "a write blocked although no client reads the line"
        received = await wire.receive(lambda data: len(data) >= 100 * accepted)
        assert received == telegram * accepted
        assert line.write(b"again\r\n")
        assert await wire.receive(lambda data: data == b"again\r\n")


async def test_a_hang_up_raises(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as line:
        reading = asyncio.ensure_future(line.read())
        await asyncio.sleep(0.01)
        wire.hang_up()
        with pytest.raises(OSError, match=GONE):
            await reading
        with pytest.raises(OSError, match=GONE):
            line.write(b"x")


async def test_a_hang_up_with_output_waiting_raises(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100_000, fresh=True) as line:
        while line.write(b"x" * 1000):
            pass
        wire.hang_up()
        with pytest.raises(OSError, match=GONE):
            await line.read()


def exclusive(wire: Wire) -> bool:
    """Whether the kernel refuses to let anybody else open the device (TIOCGEXCL of asm-generic/ioctls.h)."""
    return fcntl.ioctl(wire.near, 0x80045440, b"\0" * 4) != b"\0" * 4


async def test_a_second_program_is_kept_out_until_the_port_is_closed(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True):
        with pytest.raises(OSError, match="another program uses the port") as caught:
            open_serial(wire.device, LineSettings(9600))
        assert caught.value.errno == errno.EBUSY
        with pytest.raises(serial.SerialException):
            serial.Serial(str(wire.device), exclusive=True)
        assert exclusive(wire)
    assert not exclusive(wire)
    async with opened(wire.settings(), limit=100, fresh=True):
        pass


@pytest.mark.parametrize(
    ("device", "number"), [("/dev/none", errno.ENOENT), ("/dev/null", errno.ENOTTY), ("/tmp", errno.EISDIR)]
)
async def test_a_port_that_cannot_be_opened_is_named(device: str, number: int) -> None:
    with pytest.raises(OSError, match=device) as caught:
        open_serial(Path(device), LineSettings(9600))
    assert caught.value.errno == number
    assert type(caught.value) is not serial.SerialException


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_no_descriptor_is_left_open(wire: Wire) -> None:
    before = open_descriptors()
    for _ in range(3):
        async with opened(wire.settings(), limit=100, fresh=True) as line:
            line.write(b"x")
    assert open_descriptors() == before


def test_the_time_on_the_line_counts_start_parity_and_stop_bits() -> None:
    settings = SerialPortSettings(device=Path("/dev/ttyS1"), parity="even", stop_bits=2)
    assert seconds_on_line(settings, 96) == pytest.approx(0.12)
    assert describe(settings) == "/dev/ttyS1, 9600 baud 8E2"


class TestADeviceThatAnswersSlowly:
    """An adapter that hangs is given five seconds for each question; the loop must not wait with it."""

    async def test_opening_holds_nobody_and_what_nobody_wants_any_more_is_closed(
        self, wire: Wire, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        asked, may_go, closed = threading.Event(), threading.Event(), threading.Event()

        def slowly(*arguments: Any, **named: Any) -> serial.Serial:
            asked.set()
            may_go.wait(60)
            return open_serial(*arguments, **named)

        def close(device: serial.Serial) -> None:
            close_serial(device)
            closed.set()

        monkeypatch.setattr(port, "open_serial", slowly)
        monkeypatch.setattr(port, "close_serial", close)
        opening = asyncio.ensure_future(opened(wire.settings(), limit=100, fresh=True).__aenter__())
        assert await asyncio.to_thread(asked.wait, 60)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        may_go.set()
        assert await asyncio.to_thread(closed.wait, 60)
        assert not exclusive(wire)

    async def test_closing_is_left_to_itself(self, wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
        may_end = threading.Event()

        def slowly(device: serial.Serial) -> None:
            may_end.wait(60)
            close_serial(device)

        monkeypatch.setattr(port, "close_serial", slowly)
        monkeypatch.setattr(port, "CLOSE_TIMEOUT_S", 0.1)
        async with opened(wire.settings(), limit=100, fresh=True):
            began = time.perf_counter()
        assert 0.09 < time.perf_counter() - began < 30.0
        may_end.set()


@pytest.mark.parametrize(("kind", "is_there"), [("0", False), ("4", True), (None, True)])
def test_a_port_of_no_hardware_is_none_and_one_of_an_adapter_has_no_type(
    kind: str | None, is_there: bool, tmp_path: Path
) -> None:
    (tmp_path / "ttyS7").mkdir()
    if kind is not None:
        (tmp_path / "ttyS7" / "type").write_text(f"{kind}\n")
    assert has_hardware(Path("/dev/ttyS7"), tmp_path) is is_there
