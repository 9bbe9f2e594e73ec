"""Composition of a daemon's history and of the recordings of its last frames, according to its config."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

from altd import __version__
from altd.acquisition.exposures_writer import RecordingPlan
from altd.acquisition.kept_frames.keeper import FrameKeeper, Source
from altd.acquisition.kept_frames.ring import FrameRing
from altd.acquisition.kept_frames.store import RecordingStore
from altd.app.parts import AnyCalibration, led_plate_of
from altd.app.settings import service_folder
from altd.config import Config
from altd.config.unit import target_headers, unit_header
from altd.errors import one_line
from altd.history.columns import columns_of
from altd.history.history import History, NoHistoryError
from altd.history.outbox import Outbox
from altd.history.reader import Reader
from altd.history.recorder import HistoryRecorder
from altd.history.records import About
from altd.history.running import before_start
from altd.history.store import Store
from altd.ports import Camera, Clock
from altd.publish.serial.parts_text import Past
from altd.recording.header import Kind
from altd.records import Measurement, Quantities
from altd.runtime.service_manager import state_folder
from altd.status.availability import MONTH_S, Availability, Before
from altd.status.event_log import EventKind
from altd.status.health import State
from altd.status.services import KeptRecording
from altd.status.state import StateEvents, UnitState
from altd.status.unit import PublishedUnit

RECORDINGS = "recordings"
"""Name of the recordings' folder in the service's folder."""

_MARGIN_NS = 10**9
"""Additional length of the ring: a recording starts shortly after its last frame."""


def folder_of_recordings(config: Config, state_folder: Path | None) -> Path | None:
    """Return the folder of recordings; None: there is none."""
    if config.kept_frames.folder is not None or state_folder is None:
        return config.kept_frames.folder
    return state_folder / RECORDINGS


def frame_keeper(
    config: Config,
    cameras: Mapping[str, Camera],
    folder: Path,
    state: UnitState,
    unit: PublishedUnit,
    note: Callable[[str, KeptRecording | None], None],
) -> FrameKeeper:
    """Return the keeper of frames for a config, and open the recordings service of the unit."""
    settings = config.kept_frames
    length_ns = round((settings.before_s + settings.after_s) * 1e9) + _MARGIN_NS
    ring = FrameRing(settings.memory_mb << 20, length_ns, lambda camera: cameras[camera].identity)
    header, targets = unit_header(config.unit.serial, config.targets), target_headers(config.targets)
    by, plate = "altd run, frames kept", led_plate_of(config)
    kind: Kind = "measurement" if plate is None else "planar"
    has_opaque = bool(config.switched_targets)
    plan = RecordingPlan(settings.before_s, header, targets or None, kind, by, plate, has_opaque=has_opaque)
    keeper = FrameKeeper(
        Source(ring, cameras, config.measuring, plan),
        settings,
        RecordingStore(folder, settings.disk_mb << 20),
        state.read,
        unit.health.component("kept frames"),
        note,
    )
    unit.recordings.open(keeper)
    return keeper


log = logging.getLogger("altd")

CHECK_INTERVAL_S = 5.0
"""Interval of checks of the clock, longer than the history takes to write that the clock was set."""
CLOCK_STEP_US = 500_000


class PastAvailability:
    """Reads the past availability at the start and after each setting of the clock, which dates the past."""

    def __init__(self, history: History, availability: Availability, clock: Clock) -> None:
        self._history = history
        self._availability = availability
        self._clock = clock

    async def run(self) -> None:
        """Read until cancelled. While the history cannot be read, keep the last result."""
        read_us: int | None = None
        seen_us = self._start_us()
        while True:
            start_us = self._start_us()
            if _is_same(start_us, seen_us) and not _is_same(start_us, read_us) and start_us is not None:
                try:
                    self._availability.before = await self._history.ask(partial(_before, start_us))
                    read_us = start_us
                except NoHistoryError:  # its component reports the reason; reading is retried
                    log.debug("availability: the history before this start cannot be read now")
                except Exception:  # a defect in the history must not end the measurement
                    log.exception("availability: a defect")
                    return
            seen_us = start_us
            await self._clock.sleep(CHECK_INTERVAL_S)

    def _start_us(self) -> int | None:
        """Return the UTC of this start by the current clock, µs; None: UTC is not known."""
        now_ns = self._clock.monotonic_ns()
        utc = self._clock.utc(now_ns)
        if utc is None:
            return None
        return round(utc.timestamp() * 1e6) - (now_ns - self._availability.started_ns) // 1000


def _before(start_us: int, reader: Reader) -> Before:
    return before_start(reader, start_us, MONTH_S)


def _is_same(start_us: int | None, other_us: int | None) -> bool:
    return start_us is not None and other_us is not None and abs(start_us - other_us) <= CLOCK_STEP_US


FILE_NAME = "history.db"
COMPONENT = "history"
_DEFECT_SEVERITY = 4
_NOT_KEPT_SEVERITY = 2


def history_place(config: Config) -> tuple[Path | None, str]:
    """Return the file of a config's history and empty text, or None and the reason."""
    if not config.history.enabled:
        return None, "off: disabled in [history]"
    if config.history.file is not None:
        return config.history.file, ""
    folder = state_folder()
    if folder is None:
        return None, "off: no folder to keep it in; [history] file names one"
    return folder / FILE_NAME, ""


def history_to_read(config: Config, place: Path) -> Path:
    """Return the history file of a daemon with this config, run as a service or by hand."""
    return config.history.file or service_folder(place) / FILE_NAME


def history_about(config: Config, calibration: AnyCalibration, quantities: Quantities) -> About:
    """Return the columns of a history and facts about its unit and calibration."""
    return About(
        columns_of(quantities, [target.name for target in config.targets]),
        {
            "serial": config.unit.serial,
            "version": __version__,
            "config": json.dumps(config.model_dump(mode="json")),
            "calibration": json.dumps(
                {
                    "created": calibration.created.isoformat(),
                    "note": calibration.recording_note,
                    "recording": calibration.recording_sha256,
                }
            ),
        },
    )


class DaemonHistory:
    """One daemon's events and, if ``keep_in`` was called, its history file."""

    def __init__(self, unit: PublishedUnit, state: UnitState) -> None:
        self.events = unit.events
        self.history = History(None, "this daemon keeps no history")
        """The history for interfaces."""
        self.outbox: Outbox | None = None
        self._unit = unit
        self._state = state
        self._clock = unit.clock
        self._observer = StateEvents(self.events, state.read, unit.self_check, unit.clock)
        self._recorder: HistoryRecorder | None = None

    def keep_as(self, config: Config, calibration: AnyCalibration) -> None:
        """Keep a history according to the config, or report why there is none. Call before ``recorded``."""
        path, why = history_place(config)
        if path is None:
            self.leave_out(why)
        else:
            about = history_about(config, calibration, self._unit.board.quantities)
            self.keep_in(path, config.history.max_mb * 10**6, about, config.has_outbox)

    def keep_in(self, path: Path, max_bytes: int, about: About, has_outbox: bool = False) -> None:
        """Keep the history in this file. Call before ``recorded``."""
        component = self._unit.health.component(COMPONENT)
        store = Store(path, max_bytes, about, has_outbox)
        self.history = History(path, serial=about.facts.get("serial"))
        self.outbox = Outbox(self.history) if has_outbox else None
        self._recorder = HistoryRecorder(
            store, self.events, self._state.read, component, self._clock, self.outbox
        )

    def record(self, measurement: Measurement) -> None:
        """Record a published measurement; without a history, do nothing."""
        if self._recorder is not None:
            self._recorder.take(measurement)

    def note_recording(self, text: str, kept: KeptRecording | None) -> None:
        """Note the event that frames were kept as a recording, or could not be (``kept`` None)."""
        severity = _NOT_KEPT_SEVERITY if kept is None else EventKind.RECORDING.severity
        detail = {} if kept is None else {"recording": kept.name}
        self.events.note(EventKind.RECORDING, text, None, severity, detail)

    def for_console(self) -> Past:
        """Return the past for a console."""
        return Past(self.events, self.history, lambda: self._clock.utc(self._clock.monotonic_ns()))

    def leave_out(self, why: str) -> None:
        """Keep no history, and report the reason."""
        self._unit.health.component(COMPONENT).set_state(State.OK, why)
        self.history = History(None, f"the history is {why}")

    @asynccontextmanager
    async def recorded(self) -> AsyncIterator[None]:
        """Record events and measurements during the context; note its end with the cause."""
        tasks = [asyncio.create_task(self._observer.run(), name="state events")]
        if self._recorder is not None:
            tasks.append(asyncio.create_task(self._recorder.run(), name=COMPONENT))
            past = PastAvailability(self.history, self._state.availability, self._clock)
            tasks.append(asyncio.create_task(past.run(), name="availability before this start"))
        self.events.note(EventKind.STARTED, f"altd {__version__} started")
        try:
            yield
        except asyncio.CancelledError:
            self.events.note(EventKind.STOPPED, "the daemon was asked to end")
            raise
        except BaseException as error:
            text = one_line(f"the daemon ended: {type(error).__name__}: {error}")
            self.events.note(EventKind.STOPPED, text, None, _DEFECT_SEVERITY)
            raise
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self.history.end()
