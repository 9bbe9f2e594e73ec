"""``altd run``: runs the daemon."""

from __future__ import annotations

import argparse
import asyncio
import gc
import logging
import os

from altd.cli.arguments import add_config
from altd.errors import BadInputError
from altd.process.endings import EndedBySignal, hangups, until_signal
from altd.process.logs import logging_to_stderr

SUMMARY = "run the daemon: measure and publish until it is stopped"

log = logging.getLogger("altd")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)
    parser.add_argument(
        "--rehearsal",
        action="store_true",
        help="mark values of played and simulated frames as valid, to try out readers; "
        "every interface reports it; not possible in a service",
    )
    parser.add_argument(
        "--trace-frames", action="store_true", help="log each step of each frame, with its time"
    )


def run(options: argparse.Namespace) -> int:
    """Measure and publish until a signal ends it; return status 0 then, as a service does."""
    gc.disable()  # until `real_time_interpreter`: searching what a start makes, and keeps, takes 0.2 s of it
    try:
        return _run(options)
    finally:
        gc.enable()


def _run(options: argparse.Namespace) -> int:
    from altd.app.daemon import daemon_of
    from altd.app.settings import check_restored, load_settings

    if options.rehearsal and "NOTIFY_SOCKET" in os.environ:  # systemd.exec(5): for services of Type=notify
        raise BadInputError("--rehearsal", "not possible in a service; start `altd run` by hand")
    reload = hangups()  # before the settings are read, so that no later change is missed
    if options.trace_frames:
        logging.getLogger("altd.frames").setLevel(logging.DEBUG)
    prefix = "" if "JOURNAL_STREAM" in os.environ else "altd: "  # the journal adds our name itself
    with logging_to_stderr(logging.INFO, prefix):
        check_restored(options.config)
        daemon = daemon_of(load_settings(options.config), options.config, options.rehearsal)
        try:
            asyncio.run(until_signal(daemon.run(reload), reload))
        except BadInputError:
            raise
        except EndedBySignal:
            return 0  # the normal end of a service
        except Exception:
            log.critical("a defect ended the daemon", exc_info=True)
            return 1
    return 0
