"""Reports how the whole daemon does with its lamps on a simulated chip: taken, released, lost, ended, killed.

Its first argument is the folder of the host with calibration and recording.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from support.gpio_sim import SimulatedChip
from support.guest import leave_results
from support.unit_toml import write_config

STATUS = "http://127.0.0.1:8080/api/status"
LINES = "LED_A", "LED_B", "DATA", "ERROR", "POWER", "OK"
LAMPS = """\
silent_after_s = 2
stale_after_s = 10

[http]
host = "127.0.0.1"

[lamps]
driver = "gpiod"
chip = "unit"
lines = ["LED_A", "LED_B"]

[indicators]
driver = "gpiod"
chip = "unit"
data = "DATA"
error = "ERROR"
power = "POWER"
ok = "OK"
"""


def altd(notes: Path, *arguments: object, **environment: str) -> subprocess.Popen[str]:
    pins = {"PIN_NOTES": str(notes), "PIN_CHIP": "unit", "PIN_LINES": " ".join(LINES)}
    return subprocess.Popen(
        [sys.executable, Path(__file__).with_name("watched_altd.py"), *map(str, arguments)],
        env=os.environ | pins | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def noted(notes: Path) -> list[tuple[str, dict[str, int]]]:
    return [(what, levels) for what, levels in map(json.loads, notes.read_text().splitlines())]


@contextmanager
def daemon(notes: Path) -> Iterator[subprocess.Popen[str]]:
    with altd(notes, "run", "--rehearsal", "--config", CONFIG) as process:
        try:
            yield process
        finally:
            process.kill()


def components() -> dict[str, Any]:
    try:
        with urlopen(STATUS, timeout=20) as answer:
            found: dict[str, Any] = json.load(answer)["components"]
    except OSError:
        return {}
    return found


def wait_for(what: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The components once they are so, with the seconds that it took."""
    started_s = time.monotonic()
    while not what(now := components()):
        assert time.monotonic() < started_s + 120, now
        time.sleep(0.05)
    return now | {"after_s": time.monotonic() - started_s}


def measures(now: dict[str, Any]) -> bool:
    return bool(now) and now["measuring"].get("valid", 0) > 0


def state(name: str, wanted: str) -> Callable[[dict[str, Any]], bool]:
    return lambda now: bool(now) and now[name]["state"] == wanted


def valid_in_a_second() -> int:
    before = components()["measuring"]["valid"]
    time.sleep(1)
    return int(components()["measuring"]["valid"] - before)


def watched(seconds: float) -> list[dict[str, int]]:
    """The pins, a hundred times a second."""
    end_s = time.monotonic() + seconds
    samples = []
    while time.monotonic() < end_s:
        samples.append(dict(zip(LINES, unit.levels(*LINES), strict=True)))
        time.sleep(0.01)
    return samples


def shares(samples: list[dict[str, int]]) -> dict[str, float]:
    return {line: sum(sample[line] for sample in samples) / len(samples) for line in LINES}


def data_levels(notes: Path, first: int) -> list[int]:
    """The levels of DATA in turn, from this note on, once it was lit and is dark again."""
    give_up_s = time.monotonic() + 60
    while True:
        time.sleep(0.5)
        levels = [level for level, _ in groupby(levels["DATA"] for _, levels in noted(notes)[first:])]
        if levels[-2:] == [1, 0] or time.monotonic() > give_up_s:
            return levels


folder = Path(sys.argv[1])
CONFIG = write_config(Path("altd.toml"), folder / "cal.json", folder / "beam", LAMPS)
unit = SimulatedChip("unit", LINES)
unit.pull_up("OK", "LED_B")  # wired so that they are lit when they are not driven
results: dict[str, Any] = {}

first = Path("first.notes").absolute()
with daemon(first) as running:
    results["up"] = wait_for(lambda now: measures(now) and state("indicators", "ok")(now))
    time.sleep(2)
    results["measuring"] = shares(watched(4))
    last = len(noted(first)) - 1
    with urlopen("http://127.0.0.1:8080/api/measurement") as answer:
        answer.read()
    results["after one request"] = data_levels(first, last)

    trial = altd(Path("trial.notes"), "lamps", "test", "--config", CONFIG)
    results["test while it runs"] = [*trial.communicate(), trial.returncode]

    unit.unplug()
    results["unplugged"] = wait_for(
        lambda now: state("indicators", "failed")(now) and state("lamps", "failed")(now)
    )
    results["valid while unplugged"] = valid_in_a_second()
    unit.plug()
    unit.pull_up("OK", "LED_B")
    results["plugged"] = wait_for(lambda now: state("indicators", "ok")(now) and state("lamps", "ok")(now))

    running.send_signal(signal.SIGTERM)
    _, complaints = running.communicate(timeout=30)
    results["ended"] = [running.returncode, complaints]
results["notes of the ended"] = noted(first)

second = Path("second.notes").absolute()
with unit.held("blinker", "OK") as blinker, unit.held("torch", "LED_A") as torch, daemon(second) as running:
    results["taken"] = wait_for(lambda now: measures(now) and state("indicators", "failed")(now))
    results["valid while taken"] = valid_in_a_second()
    blinker.kill()
    torch.kill()
    results["let go"] = wait_for(lambda now: state("indicators", "ok")(now) and state("lamps", "ok")(now))
    time.sleep(1)
    running.kill()
    running.wait()
results["pins of the killed"] = dict(zip(LINES, unit.levels(*LINES), strict=True))

for name, result in (("failed", "watchdog"), ("well", "success")):
    notes = Path(f"{name}.notes").absolute()
    after = altd(notes, "lamps", "stopped", "--config", CONFIG, SERVICE_RESULT=result)
    results[f"stopped, {name}"] = [*after.communicate(), after.returncode]
    results[f"notes, {name}"] = noted(notes)

with unit.held("blinker", "OK"):
    notes = Path("partly.notes").absolute()
    after = altd(notes, "lamps", "off", "--config", CONFIG)
    results["off, partly taken"] = [*after.communicate(), after.returncode]
    results["notes, partly taken"] = noted(notes)

notes = Path("test.notes").absolute()
trial = altd(notes, "lamps", "test", "--config", CONFIG)
results["test"] = [*trial.communicate(), trial.returncode]
results["notes, test"] = noted(notes)

notes = Path("on.notes").absolute()
trial = altd(notes, "lamps", "on", "--config", CONFIG)
assert trial.stdout is not None
results["on"] = [trial.stdout.readline(), unit.levels(*LINES)]
trial.terminate()
results["on, ended"] = trial.wait()
results["notes, on"] = noted(notes)

leave_results(results)
