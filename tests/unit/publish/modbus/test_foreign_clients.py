"""The values as mbpoll reads them, a client that this project did not write, and the page that shows them."""

import asyncio
import re
import subprocess
import zlib
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.foreign import need_program
from support.modbus_wire import UNIT, Measured
from support.places import ROOT

from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.status.board import Board
from tools.pages import modbus as page


async def mbpoll(*arguments: object) -> list[str]:
    """The lines with values that mbpoll prints, of registers counted from 0 with the high word first."""
    command = [need_program("mbpoll"), "-0", "-1", "-B", "-o", "10", *map(str, arguments)]
    done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if re.match(r"\[\d+\]", line)]


@pytest.mark.parametrize("table", [3, 4])
async def test_over_tcp_mbpoll_reads_what_the_page_shows(
    tcp: ModbusTcpPublisher, board: Board, clock: FakeClock, table: int
) -> None:
    assert page.EXAMPLE.measurement is not None
    board.publish(replace(page.EXAMPLE.measurement, t_ns=clock.now_ns))
    at = ("-m", "tcp", "-p", tcp.port, "-a", UNIT, "127.0.0.1")

    assert await mbpoll("-t", f"{table}:float", "-r", 20, "-c", len(page.SHOWN), *at) == page.mbpoll_lines()
    assert "\n".join(f"    {text}" for text in page.mbpoll_lines()) in page.page()
    assert (await mbpoll("-t", f"{table}:int", "-r", 60, "-c", 7, *at))[-2:] == [
        "[70]: \t-300007",
        "[72]: \t-2147483648",
    ]
    assert await mbpoll("-t", f"{table}:float", "-r", 100, *at) == ["[100]: \t123.456"]
    assert await mbpoll("-t", f"{table}:int", "-r", 104, *at) == ["[104]: \t-123456789"]
    assert await mbpoll("-t", f"{table}:hex", "-r", 102, "-c", 2, *at) == [
        "[102]: \t0x1234",
        "[103]: \t0x5678",
    ]


async def test_the_checked_block_as_mbpoll_reads_it_passes_its_crc(
    tcp: ModbusTcpPublisher, board: Board, measured: Measured
) -> None:
    board.publish(measured())
    read = await mbpoll(
        *("-t", "4:hex", "-r", 200, "-c", 80, "-m", "tcp", "-p", tcp.port, "-a", UNIT, "127.0.0.1")
    )
    assert [int(line[1:4]) for line in read] == list(range(200, 280))
    block = b"".join(int(line.split()[1], 16).to_bytes(2) for line in read)
    assert zlib.crc32(block[:-4]) == int.from_bytes(block[-4:])
    assert block[4:8] == zlib.crc32(b"ALT-0007").to_bytes(4)


def test_the_page_in_docs_is_the_generated_one() -> None:
    assert (ROOT / "docs" / "modbus.md").read_text() == page.page(), "run: make pages"


def test_the_page_says_which_bits_a_valid_measurement_may_have_and_which_warnings_have_none() -> None:
    text = " ".join(page.page().split())
    bit_15 = next(line for line in page.page().splitlines() if line.startswith("| 15 |"))
    assert "with bit 0 at 1 a warning: `geometry_suspect`, `geometry_unknown`, `compensated` |" in bit_15
    assert "Bits 7, 12, 13 and 15 may be set beside bit 0, as warnings" in text
    assert "The warnings `rehearsal`, `roll_missing`, `pitch_diverges` have no bit." in text
    assert "2 at once for a rehearsal, 4 after ten seconds for the inclinometer" in text
