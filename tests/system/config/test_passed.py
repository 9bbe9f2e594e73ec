"""`altd run` starts with a config that `check-config` accepts: interfaces get their addresses and ports."""

import asyncio
from pathlib import Path

import pytest
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.unit_toml import ALL_FACES, played_toml

from altd.app.daemon import daemon_of
from altd.app.interfaces import interfaces_of
from altd.app.parts import check_files
from altd.app.settings import load_settings
from altd.status.health import State

STARTED_S = 1.5
"""All interfaces are tried within 1 s."""

VARIANTS = (
    ("window = 4", "window = 1000"),
    ("window = 4", "window = 4\nevery = 1000\nstale_after_s = 60"),
    ("window = 4", 'window = 4\npair_by = "time"'),
    ("window = 4", "window = 4\nsilent_after_s = 0.001\nstale_after_s = 0.001"),
    ('host = "127.0.0.2"', 'host = "::1"'),
    ('host = "127.0.0.1"', 'host = "localhost"'),
    ("repeat = true", "repeat = false"),
    ("repeat = true", 'repeat = true\npace = "fast"'),
    ("[installation]", "[installation]\noffset_yaw_deg = 45\nreference_plane_mm = -100000"),
    ('device = "/dev/altd-none-0"', 'device = "/dev/null"'),
    ("interval_s = 0.5", "interval_s = 0.18"),
)


@pytest.mark.parametrize(("old", "new"), VARIANTS)
async def test_a_variant_that_passes_starts(
    played_unit: PlayedUnit, tmp_path: Path, old: str, new: str
) -> None:
    path = tmp_path / "altd.toml"
    text = played_toml(played_unit.calibration, played_unit.beams, ALL_FACES.format(port=free_port()))
    assert old in text
    path.write_text(text.replace(old, new))
    settings = load_settings(path)
    assert not check_files(settings)[1]
    daemon = daemon_of(settings, path)
    running = asyncio.create_task(daemon.run())
    done, _ = await asyncio.wait([running], timeout=STARTED_S)
    assert not done, running.exception()
    places = [place for place in interfaces_of(settings) if not place.startswith("serial ")]
    states = {place: daemon.health.component(place).state for place in places}
    assert states == dict.fromkeys(places, State.OK)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
