"""GPIO chips of the kernel's simulator, seen from the other side: at their pins.

For programs in a guest. A line without a consumer has the level of its pull.
"""

import functools
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_CONFIG = Path("/sys/kernel/config/gpio-sim")

_HOLD = """
import sys, gpiod
from gpiod.line import Direction
chip, consumer, *lines = sys.argv[1:]
settings = gpiod.LineSettings(direction=Direction.OUTPUT)
with gpiod.request_lines(chip, consumer=consumer, config={tuple(lines): settings}):
    print("held", flush=True)
    sys.stdin.read()
"""


def levels_of(label: str, lines: Iterable[str]) -> list[int]:
    """The levels of a chip's pins, as they are at this moment."""
    pins, offsets = _pins(label), _offsets(label)
    return [int((pins / f"sim_gpio{offsets[line]}" / "value").read_text()) for line in lines]


@functools.cache
def _offsets(label: str) -> dict[str, int]:
    names = (_CONFIG / label / "bank0").glob("line[0-9]*/name")
    return {name.read_text().strip(): int(name.parent.name.removeprefix("line")) for name in names}


def _pins(label: str) -> Path:
    place = _CONFIG / label
    device, chip = ((place / name).read_text().strip() for name in ("dev_name", "bank0/chip_name"))
    return Path(f"/sys/devices/platform/{device}/{chip}")


class SimulatedChip:
    """A chip with these lines, "" for one without a name; it is there until ``unplug``."""

    def __init__(self, label: str, lines: Sequence[str]) -> None:
        self._place = _CONFIG / label
        self._bank = self._place / "bank0"
        self._lines = list(lines)
        self._place.mkdir()
        self._bank.mkdir()
        (self._bank / "num_lines").write_text(str(len(lines)))
        (self._bank / "label").write_text(label)
        for offset, name in enumerate(lines):
            if name:
                line = self._bank / f"line{offset}"
                line.mkdir()
                (line / "name").write_text(name)
        self.plug()

    @property
    def name(self) -> str:
        """The kernel's name of the chip, another one after each ``plug``."""
        return (self._bank / "chip_name").read_text().strip()

    @property
    def path(self) -> Path:
        return Path("/dev") / self.name

    def plug(self) -> None:
        (self._place / "live").write_text("1")

    def unplug(self) -> None:
        """The chip goes away, as a USB expander does, even while a program holds its lines."""
        (self._place / "live").write_text("0")

    def levels(self, *lines: str) -> list[int]:
        """The levels of the pins."""
        return levels_of(self._place.name, lines)

    def pull_up(self, *lines: str) -> None:
        """From now on these are high when they are not driven."""
        for line in lines:
            pin = _pins(self._place.name) / f"sim_gpio{self._lines.index(line)}"
            (pin / "pull").write_text("pull-up")

    def plug_with(self, consumer: str, line: str) -> None:
        """The chip comes back with a line that the kernel itself has from the first instant, low."""
        hog = self._bank / f"line{self._lines.index(line)}" / "hog"
        hog.mkdir()
        (hog / "name").write_text(consumer)
        (hog / "direction").write_text("output-low")
        self.plug()

    def unplug_from(self, line: str) -> None:
        """The chip goes away, and what has its line."""
        self.unplug()
        (self._bank / f"line{self._lines.index(line)}" / "hog").rmdir()

    @contextmanager
    def held(self, consumer: str, *lines: str) -> Iterator[subprocess.Popen[str]]:
        """Another program holds these lines."""
        command = [sys.executable, "-c", _HOLD, str(self.path), consumer, *lines]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
            assert holder.stdout.readline() == "held\n"
            try:
                yield holder
            finally:
                holder.kill()
