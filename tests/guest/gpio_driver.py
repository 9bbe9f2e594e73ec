"""Leaves what the GPIO driver does to the pins of a simulated chip, and what it complains of."""

import os
from collections.abc import Callable
from pathlib import Path

from support.gpio_sim import SimulatedChip
from support.guest import leave_results

from altd.devices.gpio import GpiodLampsSettings, GpiodSwitchesSettings, IndicatorsSettings
from altd.devices.gpio.find_chips import chip_paths, read_chip
from altd.devices.gpio.lamps import GpioFrameLamps, GpioIndicators, GpioSwitches, OutputLines
from altd.ports import Indicator, LampsError


def complaint(act: Callable[[], object]) -> str:
    try:
        act()
    except LampsError as error:
        return str(error)
    return "none"


def opened(chip: object, *lines: str) -> Callable[[], None]:
    return OutputLines(str(chip), lines, active_low=False).open


def as_nobody(act: Callable[[], object]) -> str:
    """The message for a user without any right."""
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
        os.write(writing, complaint(act).encode())
        os._exit(0)
    os.wait()
    return os.read(reading, 1000).decode()


results: dict[str, object] = {}
unit = SimulatedChip("unit", ["LED_A", "LED_B", "DATA", "ERROR", "POWER", "OK", "TWICE", "TWICE"])
plain = SimulatedChip("plain", ["", "", ""])

results["devices"] = [line.split()[-1] for line in Path("/proc/devices").read_text().splitlines() if line]

# frame LEDs; LED_B is high when it is not driven, so dark and released can be distinguished
unit.pull_up("LED_B")
pins = "LED_A", "LED_B"
for active_low in (False, True):
    lamps = GpioFrameLamps(GpiodLampsSettings(driver="gpiod", chip="unit", lines=pins, active_low=active_low))
    steps = {"before": unit.levels(*pins)}
    lamps.open()
    steps["opened"] = unit.levels(*pins)
    consumers = [line.used_by for line in read_chip(unit.path).lines if line.name in pins]
    for step, on in (("lit", True), ("dark", False), ("lit again", True)):
        lamps.switch(on)
        steps[step] = unit.levels(*pins)
    lamps.close()
    lamps.close()
    steps["closed"] = unit.levels(*pins)
    results[f"frame, active_low {active_low}"] = steps
    results["consumers"] = consumers

glasses = GpioSwitches(GpiodSwitchesSettings(driver="gpiod", chip="unit", lines=pins), ("t1", "t2"))
glasses.open()
steps = {"opened": unit.levels(*pins)}
for opaque in ("t1", "t2", ""):
    glasses.show(opaque)
    steps[opaque] = unit.levels(*pins)
glasses.show("t1")
glasses.close()
steps["closed"] = unit.levels(*pins)
results["glasses"] = steps

indicators = GpioIndicators(
    IndicatorsSettings(driver="gpiod", chip="unit", data="DATA", error="ERROR", power="POWER", ok="OK")
)
names = "DATA", "ERROR", "POWER", "OK"
indicators.open()
looks = [[], [Indicator.OK, Indicator.POWER], [Indicator.ERROR], list(Indicator)]
shown = {}
for look in looks:
    indicators.show(frozenset(look))
    shown[" ".join(look)] = unit.levels(*names)
indicators.close()
results["indicators"] = shown

some = GpioIndicators(IndicatorsSettings(driver="gpiod", chip=str(unit.path), error="ERROR"))
some.open()
some.show(frozenset({Indicator.ERROR, Indicator.OK}))
results["some indicators"] = unit.levels(*names)
some.close()

# a chip by name, a line by number
by_number = OutputLines(plain.name, ["2"], active_low=False)
by_number.open()
by_number.set(["2"])
results["by number"] = [line.used_by for line in read_chip(plain.path).lines]
by_number.close()

results["inventory"] = [
    [chip.name, chip.label, [line.name for line in chip.lines]] for chip in map(read_chip, chip_paths())
]

# complaints
with unit.held("blinker", "LED_B"):
    results["taken"] = complaint(opened("unit", *pins))
    results["inventory while taken"] = [line.used_by for line in read_chip(unit.path).lines]
complaints = {
    "no chip": opened("units", "LED_A"),
    "no path": opened("/dev/gpiochip77", "LED_A"),
    "no chip at the path": opened("/dev/null", "LED_A"),
    "no line": opened("unit", "LED_A", "LED_C"),
    "no line without names": opened("plain", "LED_A"),
    "number too high": opened("plain", "3"),
    "two of a name": opened("unit", "TWICE"),
    "the same line twice": opened("unit", "LED_A", "0"),
    "not open": lambda: OutputLines("unit", ["LED_A"], active_low=False).set(["LED_A"]),
}
results |= {name: complaint(act) for name, act in complaints.items()}
results["path"] = str(unit.path)
results["root alone"] = as_nobody(opened(unit.path, "LED_A"))
os.chown(unit.path, 0, 44)
unit.path.chmod(0o660)
results["for a group"] = as_nobody(opened("unit", "LED_A"))

# a chip that goes away while it is held, and comes back under another number
lost = GpioFrameLamps(GpiodLampsSettings(driver="gpiod", chip="unit", lines=pins))
lost.open()
lost.switch(True)
unit.unplug()
results["gone"] = complaint(lambda: lost.switch(False))
results["while gone"] = complaint(lost.open)
other = SimulatedChip("other", ["X"])
unit.plug()
lost.open()
lost.switch(True)
results["back"] = [unit.levels(*pins), unit.path != Path(str(results["path"]))]
lost.close()

leave_results(results)
