"""The kernel's RS485 mode: what is asked of a port's driver, and what is said when it cannot do that."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.foreign import need_program
from support.wire import Wire

from altd.config.interfaces import Rs485Settings
from altd.serial_line.opening import LineSettings, open_serial
from altd.serial_port.port import describe

HERE = Path(__file__).parent
OPENS = """
import sys
from pathlib import Path
from altd.config.interfaces import Rs485Settings
from altd.serial_line.opening import LineSettings, close_serial, open_serial
try:
    rs485 = Rs485Settings.model_validate_json(sys.argv[2])
    close_serial(open_serial(Path(sys.argv[1]), LineSettings(9600, rs485=rs485)))
except OSError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A serial driver with an RS485 mode, as far as a program can see."""
    library = tmp_path_factory.mktemp("rs485") / "port.so"
    compiler = need_program("gcc")
    done = subprocess.run([compiler, "-shared", "-fPIC", "-o", library, HERE / "rs485_port.c"], check=False)
    assert done.returncode == 0
    return library


def opened(wire: Wire, driver: Path, settings: Rs485Settings, cannot: str = "") -> tuple[str, str]:
    """The driver's requests, and the opener's complaint."""
    log = driver.with_name("log")
    log.write_text("")
    environment = {**os.environ, "LD_PRELOAD": str(driver), "RS485_LOG": str(log), "RS485_PORT": cannot}
    command = [sys.executable, "-c", OPENS, str(wire.device), settings.model_dump_json()]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return log.read_text().strip(), done.stdout.strip()


@pytest.mark.parametrize(
    ("settings", "asked"),
    [
        (Rs485Settings(), "enabled on-send before 0 after 0"),
        (Rs485Settings(rts_while_sending="low"), "enabled after-send before 0 after 0"),
        (Rs485Settings(delay_before_ms=3, delay_after_ms=100), "enabled on-send before 3 after 100"),
    ],
)
def test_the_driver_is_asked_in_the_kernels_own_words(
    wire: Wire, driver: Path, settings: Rs485Settings, asked: str
) -> None:
    assert opened(wire, driver, settings) == (asked, "")


@pytest.mark.parametrize(
    ("cannot", "told"),
    [
        ("mode", "has no RS485 mode: leave rs485 out if the adapter switches direction automatically"),
        ("enable", "its driver leaves it off"),
        ("low", "rts_while_sending is the other level only"),
        ("delay", "delay_after_ms = 5 becomes 0"),
    ],
)
def test_a_driver_that_does_less_is_refused_and_says_what(
    wire: Wire, driver: Path, cannot: str, told: str
) -> None:
    _, complaint = opened(wire, driver, Rs485Settings(rts_while_sending="low", delay_after_ms=5), cannot)
    assert told in complaint
    assert str(wire.device) in complaint


def test_a_port_without_such_a_mode_is_refused_and_left_free(wire: Wire) -> None:
    for _ in range(2):
        with pytest.raises(OSError, match="has no RS485 mode") as caught:
            open_serial(wire.device, LineSettings(9600, rs485=Rs485Settings()))
        assert caught.value.errno == errno.ENOTTY


def test_health_shows_the_mode(wire: Wire) -> None:
    assert describe(wire.settings(rs485={})).endswith("9600 baud 8N1 RS485")
