"""A config that `check-config` accepts is not refused by `altd run` for a reason in the file."""

import asyncio
import re
import socket
from pathlib import Path

import pytest
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.unit_toml import ALL_FACES, played_toml

from altd.app.daemon import Daemon, daemon_of
from altd.app.parts import check_files
from altd.app.settings import load_settings
from altd.errors import BadInputError
from altd.process.addresses import overlap
from altd.status.health import State


@pytest.fixture
def text(played_unit: PlayedUnit) -> str:
    port = free_port()
    return played_toml(played_unit.calibration, played_unit.beams, ALL_FACES.format(port=port))


def passed(path: Path) -> bool:
    """Whether `altd check-config` calls the file good."""
    try:
        return not check_files(load_settings(path))[1]
    except BadInputError:
        return False


def composed(path: Path) -> Daemon:
    """The steps of `altd run` before it starts."""
    return daemon_of(load_settings(path), path)


def test_whatever_line_is_left_out_run_refuses_nothing_that_passed(text: str, tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    lines = text.splitlines()
    good = []
    for number, line in enumerate(lines):
        if not line:
            continue
        path.write_text("\n".join([*lines[:number], *lines[number + 1 :]]))
        if passed(path):
            good.append(line)
            composed(path)
        else:
            with pytest.raises(BadInputError):
                composed(path)
    assert "window = 4" in good
    assert 'serial = "TEST-1"' not in good
    assert len(good) >= 8


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (number, by)
        for number in re.findall(r"= (-?[0-9.]+)$", played_toml("", "", ALL_FACES), re.MULTILINE)
        for by in ("0", "1", "-1", "1e9", "true", '"1"', "nan", "[]")
    ],
)
def test_whatever_a_number_becomes_run_refuses_nothing_that_passed(
    text: str, tmp_path: Path, old: str, new: str
) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(text.replace(f"= {old}\n", f"= {new}\n", 1))
    if passed(path):
        composed(path)
    else:
        with pytest.raises(BadInputError):
            composed(path)


HOSTS = ("0.0.0.0", "127.0.0.1", "127.0.0.2", "localhost", "::", "::1")


@pytest.mark.parametrize(("one", "other"), [(one, other) for one in HOSTS for other in HOSTS])
def test_two_faces_have_one_port_only_where_the_kernel_gives_it_to_both(
    text: str, tmp_path: Path, one: str, other: str
) -> None:
    def listen(host: str, port: int) -> socket.socket:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, dualstack_ipv6=host == "::")

    port = free_port()
    with listen(one, port):
        try:
            listen(other, port).close()
            given = True
        except OSError:
            given = False
    assert overlap(one, other) is not given
    path = tmp_path / "altd.toml"
    before, _, between, _, after = re.split(r'"(127\.0\.0\.[12])"', text)
    path.write_text(f'{before}"{one}"{between}"{other}"{after}')
    assert passed(path) is given


async def test_what_the_kernel_refuses_an_interface_would_have_lacked(text: str, tmp_path: Path) -> None:
    """The check is no stricter than the daemon: with the rule taken away an interface fails."""
    path = tmp_path / "altd.toml"
    path.write_text(text)
    daemon = composed(path)
    assert daemon.config.http is not None
    http = daemon.config.http.model_copy(update={"host": "0.0.0.0"})
    daemon.config = daemon.config.model_copy(update={"http": http})
    component = daemon.health.component(f"http 0.0.0.0:{http.port}")
    running = asyncio.create_task(daemon.run())
    async with asyncio.timeout(60):
        while component.state is not State.FAILED:  # noqa: ASYNC110  it has no event
            await asyncio.sleep(0.01)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert "Address already in use" in component.message
