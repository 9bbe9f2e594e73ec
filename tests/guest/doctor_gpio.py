"""The doctor's findings about GPIO chips by their label, with a simulated one there."""

from dataclasses import asdict
from pathlib import Path

from support.guest import leave_results

from altd.config import Config
from altd.devices.gpio.find_chips import check
from altd.process.machine import Machine

BANK = Path("/sys/kernel/config/gpio-sim/board/bank")

BANK.mkdir(parents=True)
(BANK / "label").write_text("lamp-board")
(BANK.parent / "live").write_text("1")
targets = [{"name": name, "z_mm": z_mm, "camera": name} for name, z_mm in (("front", 0), ("rear", 280))]
found = {}
for chip in ("lamp-board", "gpiochip0", "/dev/gpiochip0", "other-board"):
    config = Config.model_validate(
        {
            "unit": {"serial": "ALT-0007", "calibration": "none"},
            "targets": targets,
            "lamps": {"driver": "gpiod", "chip": chip, "lines": ["0"]},
        }
    )
    found[chip] = [asdict(finding) for finding in check({"lamps": config.lamps}, Machine())]
leave_results(found)
