"""``altd record``: records frames for replay."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from altd.cli.arguments import add_config, add_output, progress_on
from altd.errors import BadInputError
from altd.process.endings import EndedBySignal, until_signal
from altd.process.logs import logging_to_stderr
from altd.process.standard_streams import print_errors
from altd.recording.frames_table import JOINT_COLUMNS, MAX_POSITION_MM, POSE_COLUMNS

if TYPE_CHECKING:
    from altd.config import Config
    from altd.recording.header import PlateHeader

SUMMARY = "record frames of the cameras, to replay, calibrate or check"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    add_output(parser, "DIR", "new folder for the recording")
    parser.add_argument(
        "--seconds",
        type=partial(_positive, "a number of seconds up to one day", 86_400),
        required=True,
        metavar="S",
        help="duration",
    )
    parser.add_argument(
        "--kind",
        choices=("measurement", "flat", "plate", "self-check"),
        default="measurement",
        help="content of the frames (default: measurement)",
    )
    parser.add_argument(
        "--plate",
        type=_plate,
        metavar="C,R,MM[,SIGMA_MM]",
        help="columns, rows and pitch of the plate's LEDs, and its sigma; needed with `--kind plate`",
    )
    parser.add_argument(
        "--shift",
        type=partial(_numbers, "shift", "6.25,-6.25", {"x_mm": MAX_POSITION_MM, "y_mm": MAX_POSITION_MM}),
        metavar="X,Y",
        help="shift of the plate's LEDs to the right and up, mm, for `altd verify`; write it as --shift=X,Y",
    )
    parser.add_argument(
        "--placed",
        type=partial(
            _numbers, "placing", "0.5,1,300", {"sigma_mm": 100.0, "sigma_deg": 30.0, "camera_mm": 1e5}
        ),
        metavar="MM,DEG,CAMERA_MM",
        help="sigma of the plate's place and angle on the target, and the camera's distance",
    )
    parser.add_argument(
        "--target",
        metavar="NAME",
        help="record only the camera of this target, where the plate is (default: plates on all targets)",
    )
    parser.add_argument(
        "--beam",
        type=partial(_positive, "a diameter up to 50 mm", 50),
        metavar="MM",
        help="1/e² diameter of the laser spot that will be measured, with `--plate` (default: 12)",
    )
    stated = parser.add_mutually_exclusive_group()
    stated.add_argument(
        "--pose",
        type=partial(_numbers, "pose", "0,700,-15", POSE_COLUMNS),
        metavar="A,B,PHI",
        help="known pose of the plate of `planar`, mm and degrees; write it as --pose=A,B,PHI",
    )
    stated.add_argument(
        "--joints",
        type=partial(_numbers, "place of three joints", "0,700,-15", JOINT_COLUMNS),
        metavar="J1,J2,J3",
        help="joints of the machine that moves it, mm, for `altd planar`",
    )


def run(options: argparse.Namespace) -> int:
    """Record; if interrupted, report how many exposures were recorded."""
    from altd.app.record import record_of
    from altd.app.settings import load_settings
    from altd.ports import CameraError, LampsError
    from altd.records import counted

    _check_plate_options(options)
    config = load_settings(options.config)
    plate = options.plate and _stated(options, config.unit.kind == "desk")
    if options.target is not None:
        config = _only(config, options.target)
    show, kept = progress_on("exposures"), 0

    def progress(done: int, planned: int) -> None:
        nonlocal kept
        kept = done
        show(done, planned)

    with logging_to_stderr(logging.WARNING):
        shows = options.pose or options.joints or plate or options.kind
        work = record_of(config, options.config, options.output, options.seconds, shows, progress)
        try:
            exposures = asyncio.run(until_signal(work))
        except EndedBySignal:
            print_errors(
                f"altd record: interrupted: {counted(kept, 'exposure')} in {options.output}"
                if kept
                else "altd record: interrupted before the first exposure"
            )
            raise
        except (LampsError, CameraError) as error:
            print_errors(f"altd record: {error}")
            return 1
    print_errors(f"{counted(exposures, 'exposure')} in {options.output}")
    return 0


def _check_plate_options(options: argparse.Namespace) -> None:
    if (options.kind == "plate") is not (options.plate is not None):
        raise BadInputError(
            "--plate",
            "C,R,MM must follow `--kind plate`: columns, rows and pitch of its LEDs"
            if options.plate is None
            else "requires `--kind plate`",
        )
    for name in ("beam", "placed", "shift", "target"):
        if getattr(options, name) is not None and options.plate is None:
            raise BadInputError(f"--{name}", "requires `--kind plate`")


def _only(config: Config, name: str) -> Config:
    """Return the config with one target and its camera; raises BadInputError."""
    targets = {target.name: target for target in config.targets}
    if (target := targets.get(name)) is None:
        raise BadInputError("--target", f"there is no {name!r}; possible: {', '.join(targets) or 'none'}")
    cameras = {target.camera: config.cameras[target.camera]}
    return config.model_copy(update={"targets": (target,), "cameras": cameras})


def _positive(what: str, limit: float, text: str) -> float:
    """Return a number above 0 up to a limit."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= limit:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    return value


def _numbers(what: str, example: str, limits: Mapping[str, float], text: str) -> dict[str, float]:
    """Return numbers by their names."""
    try:
        values = dict(zip(limits, map(float, text.split(",")), strict=True))
    except ValueError:
        values = dict.fromkeys(limits, math.nan)
    if not all(abs(value) <= limits[column] for column, value in values.items()):
        count = {2: "two", 3: "three"}[len(limits)]
        said = f"{text!r} is not a {what}; possible: {count} numbers such as {example}"
        raise argparse.ArgumentTypeError(said)
    return values


def _plate(text: str) -> PlateHeader:
    """Return a plate whose middle is that of the target."""
    from pydantic import ValidationError

    from altd.recording.header import PlateHeader

    try:
        columns, rows, pitch_mm, *sigma_mm = text.split(",")
        steps_x, steps_y, step_mm = int(columns) - 1, int(rows) - 1, float(pitch_mm)
        return PlateHeader(
            columns=steps_x + 1,
            rows=steps_y + 1,
            pitch_mm=step_mm,
            origin_mm=(-steps_x / 2 * step_mm, -steps_y / 2 * step_mm),
            pitch_sigma_mm=float(*sigma_mm) if sigma_mm else None,
        )
    except (TypeError, ValueError, ValidationError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a plate; possible: COLUMNS,ROWS,PITCH_MM such as 7,5,25, at least 4 × 4; "
            "with the pitch's standard uncertainty such as 7,5,25,0.05, at most a twentieth of it"
        ) from None


def _stated(options: argparse.Namespace, is_on_desk: bool) -> PlateHeader:
    """Return the plate as the options state it; raises BadInputError."""
    from pydantic import ValidationError

    from altd.recording.header import PlacedHeader

    plate: PlateHeader = options.plate
    if options.shift:
        shift_mm = tuple(options.shift.values())
        if max(map(abs, shift_mm)) >= plate.pitch_mm:
            raise BadInputError("--shift", f"must be less than the pitch, {plate.pitch_mm:g} mm")
        x_mm, y_mm = (at + by for at, by in zip(plate.origin_mm, shift_mm, strict=True))
        plate = plate.model_copy(update={"origin_mm": (x_mm, y_mm)})
    if options.beam is not None:
        plate = plate.model_copy(update={"beam_mm": options.beam})
    if options.placed:
        if plate.pitch_sigma_mm is None:
            raise BadInputError("--placed", "requires `--plate C,R,MM,SIGMA_MM`")
        try:
            plate = plate.model_copy(update={"placed": PlacedHeader(**options.placed)})
        except ValidationError:
            raise BadInputError("--placed", "needs MM and DEG from 0, CAMERA_MM from 20") from None
    elif is_on_desk:
        raise BadInputError(
            "--plate",
            "of a unit on a desk requires C,R,MM,SIGMA_MM and --placed: no picture shows its scale or tilt",
        )
    return plate
