"""Texts of the demo: the table on a terminal, the line per second elsewhere, the commands to try."""

from collections.abc import Iterator
from dataclasses import dataclass

from altd.app.daemon import Daemon
from altd.config import MqttSettings
from altd.records import Measurement, counted
from hw_sim.demo_figures import QUANTITIES, Figures, memory_mib, truth_of
from hw_sim.demo_folder import DemoFolder
from hw_sim.demo_lines import Line
from hw_sim.demo_screen import Style, StyledLine
from hw_sim.faults import Fault
from hw_sim.unit import Unit

FLOATS, FLOAT_COUNT = 20, 15
"""Address of the first value in floating point (docs/modbus.md), and the number of values."""


@dataclass(frozen=True, slots=True)
class FaultKey:
    """Effect of a key on the unit."""

    fault: Fault
    does: str


FAULT_KEYS = {
    "b": FaultKey(Fault.NO_LASER, "block beam"),
    "f": FaultKey(Fault.FRONT_SPOT_MISSING, "lose front spot"),
    "s": FaultKey(Fault.REAR_SILENT, "silence rear camera"),
    "l": FaultKey(Fault.LEDS_ON, "LEDs stuck on"),
    "m": FaultKey(Fault.REAR_CAMERA_MOVED, "move rear camera"),
}
CLEAR_KEY, QUIT_KEY = "c", "q"


@dataclass(frozen=True, slots=True)
class Faces:
    """Addresses of the unit's interfaces: TCP ports of this machine, serial lines, and a folder."""

    http_port: int
    modbus_port: int
    telegram: Line
    console: Line
    modbus_rtu: Line
    folder: DemoFolder
    mqtt: MqttSettings | None = None

    def commands(self) -> list[tuple[str, str]]:
        """Commands to try each interface, with its name. Flags and registers are those of docs/modbus.md."""
        url = f"http://127.0.0.1:{self.http_port}"
        floats = f"-1 -0 -B -t 3:float -r {FLOATS} -c {FLOAT_COUNT}"
        return [
            ("browser", f"{url}/"),
            *self.folder.commands(),
            ("HTTP", f"curl -s {url}/api/measurement"),
            ("Modbus TCP", f"mbpoll {floats} -p {self.modbus_port} 127.0.0.1"),
            ("Modbus RTU", f"mbpoll -m rtu {floats} {self.modbus_rtu.far_end}"),
            ("telegram", f"cat {self.telegram.far_end}"),
            ("console", f"picocom {self.console.far_end}    (then help; Ctrl-A Ctrl-X leaves)"),
            *self._mqtt_commands(),
        ]

    def _mqtt_commands(self) -> list[tuple[str, str]]:
        if self.mqtt is None:
            return []
        where = f"-h {self.mqtt.host} -p {self.mqtt.port_or_default}"
        return [("MQTT", f"mosquitto_sub -V 5 {where} -v -t '{self.mqtt.topic}/#'")]

    def components(self) -> dict[str, str]:
        """Names of the interfaces' components in the unit's health, by the interface's usual name."""
        return {
            "HTTP": f"http 127.0.0.1:{self.http_port}",
            "Modbus TCP": f"modbus_tcp 127.0.0.1:{self.modbus_port}",
            "RTU": f"serial {self.modbus_rtu.unit_end}",
            "telegram": f"serial {self.telegram.unit_end}",
            "console": f"serial {self.console.unit_end}",
        } | ({} if self.mqtt is None else {"MQTT": f"mqtt {self.mqtt.host}:{self.mqtt.port_or_default}"})


class View:
    """Formats measured values next to the simulator's truth."""

    heading = (
        "each value ± its sigma, in brackets the difference from the simulator's truth; "
        "every measurement carries the warnings `simulated` and `rehearsal`"
    )

    def __init__(self, daemon: Daemon, unit: Unit, faces: Faces, figures: Figures) -> None:
        self._daemon = daemon
        self._unit = unit
        self._faces = faces
        self._figures = figures
        self.title = f"Active Laser Target {unit.config.serial}, SIMULATED: nothing here is live"

    def commands(self) -> list[str]:
        """Commands to try, one on each line."""
        return [f"  {name:<11} {command}" for name, command in self._faces.commands()]

    def line(self) -> str:
        """Current state in one line."""
        measurement = self._daemon.board.read()
        self._figures.note_memory()
        head = f"{self._figures.seconds:7.1f} s  "
        if measurement is None:
            return f"{head}NOT VALID  nothing measured so far"
        status = " ".join(str(fault) for fault in measurement.status)
        if not measurement.valid:
            return f"{head}NOT VALID  {status}"
        truth = truth_of(self._unit, measurement)
        values = "  ".join(
            f"{q.name} {q.measured(measurement):8.{q.decimals}f} ±{q.sigma(measurement):.{q.decimals}f} "
            f"({q.measured(measurement) - q.true(truth):+.{q.decimals}f}) {q.unit}"
            for q in QUANTITIES
        )
        return f"{head}valid  {values}  {status}"

    def screen(self, keys: bool) -> list[StyledLine]:
        """Screen of a terminal of 80 columns and 24 rows; with the keys if there is a keyboard."""
        measurement = self._daemon.board.read()
        self._figures.note_memory()
        minutes, seconds = divmod(int(self._figures.seconds), 60)
        faults = ", ".join(sorted(self._unit.faults))
        return [
            (f"{self.title:<72}{minutes:4d}:{seconds:02d}", Style.BOLD),
            (
                f"{'':12}{'measured':>12}{'± sigma':>11}{'truth':>13}{'difference':>13}{'/ sigma':>10}",
                Style.DIM,
            ),
            *((row, Style.BOLD) for row in self._rows(measurement)),
            ("", Style.PLAIN),
            _verdict(measurement),
            *((f"  {line}", Style.PLAIN) for line in self._status_lines()),
            ("", Style.PLAIN),
            (
                f"  {'faults present: ' + faults if faults else 'no faults'}",
                Style.BAD if faults else Style.PLAIN,
            ),
            *((f"  {line}", Style.PLAIN) for line in (_KEYS if keys else ())),
            ("", Style.PLAIN),
            ("Try in another terminal (Debian packages curl, mbpoll, picocom):", Style.BOLD),
            *((line, Style.PLAIN) for line in self.commands()),
        ]

    def _rows(self, measurement: Measurement | None) -> Iterator[str]:
        truth = truth_of(self._unit, measurement) if measurement else None
        for q in QUANTITIES:
            measured = sigma = difference = in_sigmas = "-"
            if measurement is not None and measurement.valid and truth is not None:
                off = q.measured(measurement) - q.true(truth)
                measured, difference = f"{q.measured(measurement):.{q.decimals}f}", f"{off:+.{q.decimals}f}"
                sigma, in_sigmas = (
                    f"{q.sigma(measurement):.{q.decimals}f}",
                    f"{off / q.sigma(measurement):+.1f}",
                )
            true = f"{q.true(truth):.{q.decimals}f}" if truth else "-"
            cells = f"{measured:>12}{sigma:>11}{true:>13}{difference:>13}{in_sigmas:>10}"
            yield f"  {q.name:<6}{q.unit:<4}{cells}"

    def _status_lines(self) -> Iterator[str]:
        figures = self._figures
        yield (
            f"{counted(figures.frame_sets, 'exposure')}, {counted(figures.pairs_lost, 'pair')} lost, "
            f"{counted(figures.frames_dropped, 'frame')} dropped, {memory_mib():.0f} MiB, "
            f"{figures.cpu_share:.0%} of one core"
        )
        parts = []
        for name, place in self._faces.components().items():
            component = self._daemon.health.component(place)
            count = component.counters.get
            sent = ("requests", "telegrams_sent", "commands", "messages_sent")
            answered = sum(count(counter, 0) for counter in sent)
            skipped = count("events_skipped", 0) + count("telegrams_dropped", 0) + count("answers_dropped", 0)
            parts.append(
                f"{name} {answered}"
                + (f", skipped {skipped}" if skipped else "")
                + ("" if component.state == "ok" else f" {component.state.upper()}")
            )
        yield f"answers: {'; '.join(parts)}"


def _verdict(measurement: Measurement | None) -> StyledLine:
    if measurement is None:
        return "  NOT VALID: nothing measured so far", Style.BAD
    status = ", ".join(str(fault) for fault in measurement.status)
    if not measurement.valid:
        return f"  NOT VALID: {status}", Style.BAD
    return f"  VALID, mean of {counted(measurement.frames, 'exposure')}; {status}", Style.GOOD


_KEYS_A_ROW = 4
_KEY_TEXTS = [
    *(f"{key} {action.does}" for key, action in FAULT_KEYS.items()),
    f"{CLEAR_KEY} clear all faults",
    f"{QUIT_KEY} quit",
]
_KEYS = (", ".join(_KEY_TEXTS[:_KEYS_A_ROW]), ", ".join(_KEY_TEXTS[_KEYS_A_ROW:]))
