"""``python -m hw_sim gige``: a simulated unit whose cameras are on the network."""

import argparse
import contextlib
import ipaddress
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from types import FrameType

import numpy as np

from altd.errors import BadInputError
from hw_sim.arguments import natural, seconds
from hw_sim.beam import BeamPose
from hw_sim.camera import EXPOSURE_RANGE
from hw_sim.faults import parse_faults
from hw_sim.gige.camera import PIXEL_FORMATS, USUAL_CELSIUS, GigeCamera, serial_of
from hw_sim.gige.libaravis import MAX_SERIAL_LENGTH
from hw_sim.gige.loopback import camera_address, keep_discovery_on_loopback
from hw_sim.grbl_table import GrblTable
from hw_sim.lens import HEIGHT_PX, WIDTH_PX
from hw_sim.motion import SLOW_DRIVE, Vibration
from hw_sim.scan import STAGE_STREAM
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

ADDRESSES: Mapping[str, str] = {FRONT: "127.0.0.1", REAR: "127.0.0.2"}

MAX_FPS = 200.0

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def add_addresses(parser: argparse.ArgumentParser) -> None:
    """Add the addresses of the cameras."""
    for name in CAMERAS:
        parser.add_argument(
            f"--{name}",
            type=_address,
            default=ADDRESSES[name],
            metavar="ADDRESS",
            help=f"address of the {name} GigE Vision camera (default: {ADDRESSES[name]})",
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the cameras."""
    add_addresses(parser)
    parser.add_argument(
        "--only", choices=CAMERAS, help="serve this camera only; the other can be another process"
    )
    parser.add_argument("--seed", type=natural, default=1, help="selects the unit (default: 1)")
    parser.add_argument(
        "--fps", type=_fps, default=20.0, metavar="N", help="initial frames per second (default: 20)"
    )
    parser.add_argument(
        "--bits",
        type=int,
        choices=PIXEL_FORMATS,
        default=8,
        help="initial bits per pixel (default: 8)",
    )
    parser.add_argument(
        "--drive", action="store_true", help="the machine follows a slow Lissajous figure and vibrates"
    )
    parser.add_argument(
        "--line",
        nargs=2,
        type=float,
        metavar=("HZ", "MM"),
        help="the unit vibrates at one frequency, with this amplitude in x and in y",
    )
    parser.add_argument(
        "--pose",
        nargs=4,
        type=float,
        default=(0.0, 0.0, 0.0, 0.0),
        metavar=("X", "Y", "YAW", "PITCH"),
        help="pose of the beam, mm and degrees (default: 0 0 0 0)",
    )
    parser.add_argument(
        "--faults", default="", metavar="NAME,...", help="faults, by the names in hw_sim/faults.py"
    )
    parser.add_argument(
        "--listen",
        action="store_true",
        help="each line on standard input is the new list of faults, and an empty one ends all; `line HZ MM` "
        "is another vibration",
    )
    parser.add_argument(
        "--celsius",
        type=float,
        default=USUAL_CELSIUS,
        help=f"DeviceTemperature (default: {USUAL_CELSIUS:g})",
    )
    parser.add_argument(
        "--stage",
        action="store_true",
        help="put the laser on an xy stage; print the port of its Grbl controller",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after N seconds (default: never)")


def run(arguments: argparse.Namespace) -> int:
    """Serve until the duration is over or a signal arrives; raises BadInputError."""
    unit = make_unit(arguments.seed, arguments.fps, drive=arguments.drive, line=arguments.line)
    x_mm, y_mm, yaw_deg, pitch_deg = arguments.pose
    unit.place(BeamPose(x_mm, y_mm, math.tan(math.radians(yaw_deg)), math.tan(math.radians(pitch_deg))))
    unit.inject(*parse_faults(filter(None, arguments.faults.split(","))))
    names = (arguments.only,) if arguments.only else CAMERAS
    if len(serial_of(unit, FRONT)) > MAX_SERIAL_LENGTH:
        raise BadInputError("--seed", f"makes a serial number of more than {MAX_SERIAL_LENGTH} characters")
    end = _End()
    with contextlib.ExitStack() as serving:
        serving.enter_context(end.by_signals())
        cameras = []
        for name in names:
            address = getattr(arguments, name)
            serving.enter_context(camera_address(address))
            camera = GigeCamera(unit, name, address, arguments.bits, end.fail)
            serving.callback(camera.close)
            camera.set_temperature(arguments.celsius)
            cameras.append(camera)
        if all(ipaddress.IPv4Address(camera.address).is_loopback for camera in cameras):
            keep_discovery_on_loopback()
        if arguments.stage:
            table = serving.enter_context(
                GrblTable(unit, np.random.default_rng([arguments.seed, STAGE_STREAM]))
            )
            print(f"stage: {table.device.resolve()}", flush=True)
        if arguments.listen:
            threading.Thread(target=_listen, args=(unit,), name="faults", daemon=True).start()
        where = ", ".join(f"{camera.serial} at {camera.address}" for camera in cameras)
        print(
            f"simulated unit {unit.config.serial}: GigE Vision {where}; {WIDTH_PX} × {HEIGHT_PX} pixels of "
            f"{arguments.bits} bits, {arguments.fps:g} a second, {EXPOSURE_RANGE.shortest_ms:g} to "
            f"{EXPOSURE_RANGE.longest_ms:g} ms; Ctrl-C ends it",
            flush=True,
        )
        began_s, cpu_began_s = time.monotonic(), time.process_time()
        end.wait(arguments.seconds)
        cpu = (time.process_time() - cpu_began_s) / (time.monotonic() - began_s)
    made = ", ".join(f"{camera.serial} {camera.frames}" for camera in cameras)
    print(f"exposures made: {made}; CPU: {cpu:.1%} of one core", flush=True)
    if end.failure is not None:
        raise end.failure
    return 0


def make_unit(
    seed: int, fps: float = 20.0, *, drive: bool = False, line: tuple[float, float] | None = None
) -> Unit:
    """Make the served unit. Another one with the same arguments has the same truth at every instant.

    ``line``: frequency, Hz, and amplitude, mm, of a vibration.
    """
    if line:
        return Unit(UnitConfig(seed=seed, fps=fps, vibration=_one_line(*line)))
    if drive:
        return Unit(UnitConfig(seed=seed, fps=fps, drive=SLOW_DRIVE, vibration=Vibration()))
    return Unit(UnitConfig(seed=seed, fps=fps))


def _one_line(hertz: float, amplitude_mm: float) -> Vibration:
    return Vibration(amplitude_mm / math.sqrt(2.0), 0.0, (hertz,), random_share=0.0)


def _line_of(text: str) -> Vibration:
    try:
        hertz, amplitude_mm = map(float, text.split()[1:])
    except ValueError:
        hertz = amplitude_mm = math.nan
    if not (0 < hertz < math.inf and 0 <= amplitude_mm < math.inf):
        raise BadInputError(text.strip(), "is no vibration; possible: `line HZ MM`, such as `line 20 0.3`")
    return _one_line(hertz, amplitude_mm)


def _listen(unit: Unit) -> None:
    """Set the faults, or the vibration, from each line on standard input; an empty line clears the faults."""
    for text in sys.stdin:
        try:
            if text.startswith("line "):
                unit.vibrate(_line_of(text))
                continue
            faults = parse_faults(text.strip().split(",") if text.strip() else ())
        except BadInputError as error:
            print(f"hw_sim: {error}", file=sys.stderr, flush=True)
        else:
            unit.clear(*unit.faults - faults)
            unit.inject(*faults)


class _End:
    """End of the program, with its failure if any."""

    def __init__(self) -> None:
        self.failure: BaseException | None = None
        self._come = threading.Event()

    def fail(self, error: BaseException) -> None:
        """End with a camera's failure; only the first is kept."""
        self.failure = self.failure or error
        self._come.set()

    def wait(self, seconds: float | None) -> None:
        """Wait for the end, or for this time."""
        self._come.wait(seconds)

    @contextlib.contextmanager
    def by_signals(self) -> Iterator[None]:
        """Let signals end the program within the block."""

        def signalled(_number: int, _frame: FrameType | None) -> None:
            self._come.set()

        before = [(number, signal.signal(number, signalled)) for number in _ENDING]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)


def _address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not an IPv4 address") from error


def _fps(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = 0.0
    if not 1 <= fps <= MAX_FPS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to {MAX_FPS:g}")
    return fps
