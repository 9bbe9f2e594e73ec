"""Files that [http] and [modbus_tcp] name: a bad one is one line of `altd run` and `altd check-config`."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support.cli import altd, altd_here, refusal
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.unit_toml import write_config


def put(folder: Path, name: str, text: str, mode: int) -> Path:
    (folder / name).write_text(text)
    (folder / name).chmod(mode)
    return folder / name


def open_credentials(folder: Path) -> tuple[str, str]:
    put(folder, "credentials", "", 0o644)
    return 'credentials = "credentials"', f"{folder / 'credentials'}: others than its owner may read"


def no_credentials(folder: Path) -> tuple[str, str]:
    return 'credentials = "credentials"', f"{folder / 'credentials'}: No such file or directory"


def no_certificate(folder: Path) -> tuple[str, str]:
    put(folder, "unit.pem", "nonsense", 0o644)
    put(folder, "unit.key", "nonsense", 0o600)
    settings = 'certificate = "unit.pem"\nkey = "unit.key"'
    return settings, f"{folder / 'unit.pem'}: contains no certificate (PEM)"


def no_certificate_of_modbus(folder: Path) -> tuple[str, str]:
    settings, said = no_certificate(folder)
    return f'[modbus_tcp]\nport = {free_port()}\n{settings}\nclient_ca = "unit.pem"', said


@pytest.mark.parametrize("case", [open_credentials, no_credentials, no_certificate, no_certificate_of_modbus])
def test_what_cannot_be_used_is_one_line(
    tmp_path: Path, played_unit: PlayedUnit, case: Callable[[Path], tuple[str, str]]
) -> None:
    settings, said = case(tmp_path)
    more = f'[http]\nhost = "127.0.0.1"\nport = {free_port()}\n{settings}\n'
    config = write_config(tmp_path / "altd.toml", played_unit.calibration, played_unit.beams, more)
    checked = refusal(altd_here("check-config", config))
    ran = altd("run", "--config", config)
    assert said in checked
    assert ran.status == 2
    assert [line for line in ran.err.splitlines() if said in line] == ran.err.splitlines()[-1:]
    assert "Traceback" not in ran.err
