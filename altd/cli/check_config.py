"""``altd check-config``: checks whether settings can be used."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from altd.cli.arguments import add_config
from altd.process.standard_streams import print_errors, print_lines

if TYPE_CHECKING:
    from altd.config import Config

_USUAL_MM = (100.0, 1000.0)
"""Usual distances of a unit's targets; others are no error. The sigma of yaw and pitch is that of a position
divided by the distance: at 28 mm, a slip of a digit, it is ten times that of 280 mm."""

SUMMARY = "check settings and the files that they name"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    either = parser.add_mutually_exclusive_group()
    add_config(either)
    either.add_argument(
        "config", nargs="?", default=argparse.SUPPRESS, metavar="FILE", help="the same as --config FILE"
    )


def run(options: argparse.Namespace) -> int:
    """Report the result, missing files and taken ports; return 2 for settings that cannot be used."""
    from altd.acquisition.glasses import round_s
    from altd.app.parts import check_files, missing_files
    from altd.app.self_check import fps_of
    from altd.app.settings import check_restored, load_settings
    from altd.devices.playback import RecordingCameraSettings
    from altd.doctor.network import taken_ports
    from altd.process.machine import Machine
    from altd.records import counted

    check_restored(Path(options.config))
    config = load_settings(Path(options.config))
    calibration, errors = check_files(config)
    for error in errors:
        print_errors(f"altd check-config: {error}")
    if errors:
        return 2
    if config.unit.instrument == "chain" and not _powers_suffice(config):
        return 2
    if config.switched_targets:
        shortest_s, longest_s = round_s(config, fps_of(config))
        print_lines(f"a round takes {shortest_s:.1f} to {longest_s:.1f} s")
    simulated = calibration is not None and calibration.simulated
    origin = ", calibrated from SIMULATED frames" if simulated else ""
    has = f"{len(config.targets)} targets" if config.targets else counted(len(config.cameras), "camera")
    print_lines(f"{options.config}: good: unit {config.unit.serial}, {has}{origin}")
    if simulated or any(isinstance(camera, RecordingCameraSettings) for camera in config.cameras.values()):
        print_lines(f"{options.config}: not live: its values are valid only with `altd run --rehearsal`")
    if config.unit.instrument == "beam" and not config.switched_targets:
        distance_mm = config.targets[-1].z_mm - config.targets[0].z_mm
        if not _USUAL_MM[0] <= distance_mm <= _USUAL_MM[1]:
            print_lines(f"{options.config}: first and last target are {distance_mm:g} mm apart: check z_mm")
    for missing in missing_files(config):
        print_lines(f"{options.config}: {missing}")
    for taken in taken_ports(config, Machine()):
        print_lines(f"{options.config}: {taken.subject}: {taken.text}: end it, or choose another port")
    return 0


def _powers_suffice(config: Config) -> bool:
    """Print the power on each target of a row; return whether it suffices for all."""
    from altd.config import RowSettings
    from altd.instruments.row.beam import powers_mw

    settings = config.chain or RowSettings()
    powers = powers_mw(settings, len(config.targets))
    for number, (target, power_mw) in enumerate(zip(config.targets, powers, strict=True)):
        print_lines(
            f"{target.name}: {power_mw:.4f} mW,"
            f" {settings.transmission:g}^{number} of {settings.laser_mw:g} mW"
        )
    weak = [target.name for target, mw in zip(config.targets, powers, strict=True) if mw < settings.min_mw]
    if weak:
        print_errors(
            f"altd check-config: {', '.join(weak)}: less than chain.min_mw, {settings.min_mw:g} mW: too dim"
        )
    return not weak
