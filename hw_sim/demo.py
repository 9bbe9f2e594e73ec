"""``python -m hw_sim demo``: a simulated unit, measured by the real daemon, to watch and to query."""

import argparse
import asyncio
import contextlib
import io
import logging
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of, cameras_of, lamps_of
from altd.config import (
    Config,
    ConsolePortSettings,
    HttpSettings,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    Target,
    TelegramPortSettings,
)
from altd.config import Unit as UnitTable
from altd.errors import BadInputError, unwrap_group
from altd.ports import Camera, Lamps
from altd.tcp_port import listen
from hw_sim.arguments import natural, port, seconds
from hw_sim.camera import RealTimeLamps, make_cameras
from hw_sim.demo_figures import Figures
from hw_sim.demo_folder import demo_folder
from hw_sim.demo_gige import served
from hw_sim.demo_lines import Line
from hw_sim.demo_screen import Screen, keys
from hw_sim.demo_view import CLEAR_KEY, FAULT_KEYS, QUIT_KEY, Faces, View
from hw_sim.gige.command import add_addresses, make_unit
from hw_sim.ports import free_port
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit

REDRAW_INTERVAL_S = 0.2
LINE_INTERVAL_S = 1.0

LOCALHOST = "127.0.0.1"

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the demo."""
    parser.add_argument("--seed", type=natural, default=1, help="selects the unit (default: 1)")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="calibration of this unit (default: made at the start)",
    )
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="FOLDER",
        help="keep history, recordings and calibration there (default: deleted at the end)",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after N seconds (default: never)")
    parser.add_argument(
        "--http-port", type=port, default=0, metavar="PORT", help="port of HTTP (default: a free one)"
    )
    parser.add_argument(
        "--modbus-port",
        type=port,
        default=0,
        metavar="PORT",
        help="port of Modbus TCP (default: a free one)",
    )
    parser.add_argument(
        "--mqtt", type=_broker, metavar="HOST[:PORT]", help="also publish to this MQTT broker"
    )
    parser.add_argument(
        "--gige",
        action="store_true",
        help="read the cameras by GigE Vision, from a second process",
    )
    add_addresses(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the demo until its duration is over, ``q`` or a signal; raises BadInputError."""
    for number in filter(None, (arguments.http_port, arguments.modbus_port)):
        _check_free(number)
    return run_until_stopped(partial(_demo, arguments))


def run_until_stopped(demo: Callable[[Callable[[], None]], Coroutine[None, None, None]]) -> int:
    """Run a demo, called with a function that ends it, until that or a signal; raises its failure."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # for a terminal that lacks ±
    try:
        asyncio.run(_until_stopped(demo))
    except KeyboardInterrupt:  # raised before or after the loop, which handles the signal itself
        return 0
    except BrokenPipeError:  # the reader of standard output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    finally:
        for number in _ENDING:  # already ending: further requests are ignored
            signal.signal(number, signal.SIG_IGN)
    return 0


async def _until_stopped(made: Callable[[Callable[[], None]], Coroutine[None, None, None]]) -> None:
    """Run the demo and cancel it once, however often its end is requested; raises its failure."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in _ENDING:
        loop.add_signal_handler(number, stop.set)
    demo = asyncio.create_task(made(stop.set), name="demo")
    stopped = asyncio.create_task(stop.wait(), name="stop")
    await asyncio.wait({demo, stopped}, return_when=asyncio.FIRST_COMPLETED)
    for task in (demo, stopped):
        task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await demo


async def _demo(arguments: argparse.Namespace, stop: Callable[[], None]) -> None:
    """Make a unit, calibrate it if necessary and measure with it; ends by cancellation or a failure."""
    async with contextlib.AsyncExitStack() as parts:
        folder = parts.enter_context(demo_folder(arguments.keep))
        calibration = arguments.calibration
        if calibration is None:
            calibration = folder.calibration
            await _calibrate(arguments.seed, calibration)
        unit = make_unit(arguments.seed, drive=True)
        hardware = None
        if arguments.gige:
            serving = served(arguments.seed, {name: getattr(arguments, name) for name in CAMERAS})
            hardware = await parts.enter_async_context(serving)
        telegram, console, modbus_rtu = (parts.enter_context(Line()) for _ in range(3))
        faces = Faces(
            http_port=arguments.http_port or free_port(),
            modbus_port=arguments.modbus_port or free_port(),
            telegram=telegram,
            console=console,
            modbus_rtu=modbus_rtu,
            folder=folder,
            mqtt=arguments.mqtt,
        )
        config = _config(unit, calibration, faces)
        leds = RealTimeLamps()
        lamps: Lamps | None = leds
        cameras: dict[str, Camera] = {camera.name: camera for camera in make_cameras(unit, lamps=leds)}
        if hardware is not None:
            config = config.model_copy(update=hardware.tables)
            cameras = cameras_of(config, Path("--gige"))
            lamps = lamps_of(config, cameras, Path("--gige"))
        known = calibration_of(config, cameras)
        daemon = Daemon(config, known, cameras, lamps=lamps, rehearsal=True)
        daemon.past.keep_as(config, known)
        figures = Figures(daemon, unit, "daemon alone") if hardware else Figures(daemon, unit)
        view = View(daemon, unit, faces, figures)
        show = _on_screen if sys.stdout.isatty() else _line_by_line
        if arguments.seconds is not None:
            asyncio.get_running_loop().call_later(arguments.seconds, stop)
        try:
            await together(
                daemon.run(),
                figures.follow(),
                telegram.forward(),
                console.forward(),
                modbus_rtu.forward(),
                show(view, unit, stop),
                *([hardware.follow(unit)] if hardware else []),
            )
        finally:
            if figures.frame_sets:
                print("The demo has ended.", *figures.summary(), sep="\n", flush=True)


async def together(*work: Coroutine[None, None, None]) -> None:
    """Run until cancelled or until one fails; a failure with a message of its own is raised ungrouped."""
    try:
        async with asyncio.TaskGroup() as tasks:
            for one in work:
                tasks.create_task(one)
    except BaseExceptionGroup as group:
        error = unwrap_group(group, BadInputError, BrokenPipeError)
        if error is None:
            raise
        raise error from None


async def _on_screen(view: View, unit: Unit, stop: Callable[[], None]) -> None:
    """Redraw the terminal in place and handle its keys."""
    logging.getLogger("altd").addHandler(logging.NullHandler())  # the screen shows the interfaces' states

    def pressed(key: str) -> None:
        if key in FAULT_KEYS:
            unit.inject(FAULT_KEYS[key].fault)
        elif key == CLEAR_KEY:
            unit.clear()
        elif key == QUIT_KEY:
            stop()

    screen = Screen()
    with screen.open(), keys(pressed) as there_are_keys:
        while True:
            await screen.draw(view.screen(there_are_keys))
            await asyncio.sleep(REDRAW_INTERVAL_S)


async def _line_by_line(view: View, _unit: Unit, _stop: Callable[[], None]) -> None:
    """Write one line each second for a file, a pipe or a log."""
    logging.basicConfig(level=logging.WARNING, format="altd: %(message)s", stream=sys.stderr)
    text = "\n".join([view.title, *view.commands(), view.heading])
    while True:
        # in a thread: a pipe without a reader must not block the unit
        await asyncio.to_thread(print, text, flush=True)
        await asyncio.sleep(LINE_INTERVAL_S)
        text = view.line()


async def _calibrate(seed: int, calibration: Path) -> None:
    """Scan and calibrate with the same two commands as for every new unit before its first use."""
    with tempfile.TemporaryDirectory(prefix="altd-scan-") as folder:
        scan = str(Path(folder, "scan"))
        print(
            f"Recording a calibration scan of simulated unit {seed} (python -m hw_sim scan) ...", flush=True
        )
        await command("hw_sim", "scan", "--seed", str(seed), "-o", scan)
        print("Fitting the unit's maps to it (altd calibrate) ...", flush=True)
        await command("altd.cli", "calibrate", scan, "-o", str(calibration))


async def command(module: str, *arguments: str) -> None:
    """Run a command; raises BadInputError if it fails, after it has printed the cause on standard error."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        module,
        *arguments,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C goes to the demo alone, which ends the command
    )
    try:
        status = await process.wait()
    except asyncio.CancelledError:
        process.kill()
        await process.wait()
        raise
    if status != 0:
        raise BadInputError(f"{module} {arguments[0]}", f"ended with status {status}")


def _config(unit: Unit, calibration: Path, faces: Faces) -> Config:
    """Config of an ordinary unit with all interfaces, on this machine only."""
    return Config(
        unit=UnitTable(serial=unit.config.serial, calibration=calibration),
        targets=(
            Target(name=FRONT, z_mm=0.0, camera=FRONT),
            Target(name=REAR, z_mm=unit.config.target_distance_mm, camera=REAR),
        ),
        modbus_tcp=ModbusTcpSettings(host=LOCALHOST, port=faces.modbus_port),
        http=HttpSettings(host=LOCALHOST, port=faces.http_port),
        mqtt=faces.mqtt,
        local=faces.folder.local,
        history=faces.folder.history,
        kept_frames=faces.folder.kept_frames,
        serial=(
            TelegramPortSettings(device=faces.telegram.unit_end, speaks="telegram"),
            ConsolePortSettings(device=faces.console.unit_end, speaks="console"),
            # mbpoll's default, which the Modbus specification recommends
            ModbusRtuPortSettings(
                device=faces.modbus_rtu.unit_end, speaks="modbus_rtu", baud=19200, parity="even"
            ),
        ),
    )


def _check_free(number: int) -> None:
    """Raise BadInputError if a program listens on the port, before the calibration takes its time."""
    try:
        listen(LOCALHOST, number).close()
    except OSError as error:
        raise BadInputError(f"port {number}", error.strerror or str(error)) from error


def _broker(text: str) -> MqttSettings:
    host, colon, number = text.rpartition(":")
    try:
        return MqttSettings(host=host or text, port=port(number) if colon else None)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a broker; possible: HOST or HOST:PORT") from error
