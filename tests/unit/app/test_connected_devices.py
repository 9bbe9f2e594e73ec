"""``altd devices`` where nothing is connected; with devices: ``tests/system/app``."""

from __future__ import annotations

import pytest

from altd.cli.main import main


def test_what_is_not_there_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("altd.devices.gpio.find_chips.chip_paths", list)
    assert main(["devices"]) == 0
    sections = [part.splitlines() for part in capsys.readouterr().out.split("\n\n")]
    assert ["GPIO chips: [lamps], [indicators]", "  none"] in sections
    assert len(sections) == 4
