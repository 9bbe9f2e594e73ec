"""``altd lamps``: switches frame LEDs and indicators while the daemon is stopped."""

from __future__ import annotations

import argparse
import os
import signal
import threading
from collections.abc import Callable
from types import FrameType

from altd.cli.arguments import add_config
from altd.errors import BadInputError
from altd.process.endings import EndedBySignal
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "switch frame LEDs and indicators while the daemon is stopped"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "look",
        choices=("off", "on", "test", "stopped"),
        help="off: dark; on: all lit until Ctrl-C; test: each in turn, with its name; "
        "stopped: dark, Error lit if the service has failed (for systemd, reads $SERVICE_RESULT)",
    )
    add_config(parser)


def run(options: argparse.Namespace) -> int:
    """Switch the lamps as requested; return 1 if they are not available."""
    from altd.app.lamps_by_hand import LampsByHand
    from altd.app.parts import cameras_of, lamps_of
    from altd.app.settings import load_beam_settings
    from altd.devices.camera_lamps import CameraLampsSettings
    from altd.ports import Indicator, LampsError

    config, place = load_beam_settings(options.config), options.config
    stopped = options.look == "stopped"
    if stopped and isinstance(config.lamps, CameraLampsSettings):
        config = config.model_copy(
            update={"lamps": None}
        )  # the camera of a dead daemon stays locked for a while
    if config.lamps is None and config.indicators is None and not stopped:
        raise BadInputError(place, "no [lamps] and no [indicators] table")
    cameras = cameras_of(config, place) if isinstance(config.lamps, CameraLampsSettings) else {}
    fitted = [Indicator(key) for key in config.indicators.lines] if config.indicators is not None else []
    lamps = lamps_of(config, cameras, place, alone=True)
    indicators = None if config.indicators is None else config.indicators.indicators()
    by_hand = LampsByHand(lamps, indicators, fitted, print_lines)
    failed = os.environ.get("SERVICE_RESULT", "success") != "success"
    actions: dict[str, Callable[[], None]] = {
        "off": lambda: by_hand.leave_lit(frozenset()),
        "on": lambda: by_hand.light_until(interrupted.wait),
        "test": by_hand.light_in_turn,
        "stopped": lambda: by_hand.leave_lit(frozenset({Indicator.ERROR} if failed else ())),
    }
    interrupted, interrupts = threading.Event(), list[EndedBySignal]()

    def interrupt(number: int, frame: FrameType | None) -> None:
        """End, so that lit lamps go dark; set the event too: a library's callback swallows the exception."""
        interrupts.append(EndedBySignal(number))
        interrupted.set()
        raise interrupts[0]

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)
    try:
        actions[options.look]()
        if interrupts:
            raise interrupts[0]
    except LampsError as error:
        print_errors(f"altd lamps: {error}")
        return 1
    return 0
