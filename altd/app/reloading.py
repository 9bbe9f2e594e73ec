"""Reloads the settings while the unit measures: applies all changes or none."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator, Mapping
from functools import partial
from hashlib import sha256
from pathlib import Path

from altd.app.diagnostics import diagnostic_parts
from altd.app.interfaces import Interfaces
from altd.app.parts import AnyCalibration, interface_checks, missing_files
from altd.app.settings import settings_of
from altd.calibration.file import MAX_BYTES
from altd.config import Config
from altd.config.loading import read_config
from altd.errors import BadInputError
from altd.files.reading import read_file
from altd.runtime.service_manager import ServiceManager
from altd.runtime.threads import call_in_thread
from altd.status.event_log import EventKind
from altd.status.health import State
from altd.status.unit import PublishedUnit

RELOADED = ("modbus_tcp", "http", "mqtt", "opcua", "local", "serial", "stage", "scan")
"""Tables that may change: the interfaces' tables, and tables that only other commands read."""

_SETTLE_S = 0.2
"""Time between two reads of the file; a file that is still being written differs after it."""

_READ_TIMEOUT_S = 20.0
_FIXED = "cannot change while the unit measures: restart altd"

log = logging.getLogger("altd")


class Reloading:
    """Reloads one daemon's settings from ``place``; ``config`` and ``calibration`` are in use."""

    def __init__(self, place: Path, config: Config, calibration: AnyCalibration, unit: PublishedUnit) -> None:
        self._place = place
        self._config = config
        self._calibration = calibration
        self._unit = unit

    async def run(self, requested: asyncio.Event, interfaces: Interfaces, manager: ServiceManager) -> None:
        """Reload at each request, until cancelled; requests during a reload count as one."""
        while True:
            await requested.wait()
            requested.clear()
            with manager.reloading():
                await self._reload(interfaces)

    async def _reload(self, interfaces: Interfaces) -> None:
        """Apply the settings in the file, or report why they are refused."""
        try:
            config, digest, changed = await self._read()
            await interfaces.change_to(config)
        except BadInputError as error:
            self._refuse(*error.lines)
        except TimeoutError:
            self._refuse(f"{self._place}: the disk does not answer")
        except Exception as error:  # a defect must not end the measurement
            log.exception("reload: a defect")
            self._refuse(f"a defect: {type(error).__name__}")
        else:
            self._config = config
            self._unit.facts = self._unit.facts.model_copy(update={"config_sha256": digest})
            self._unit.diagnostics = diagnostic_parts(config)
            self._report(State.OK, f"settings reloaded: {', '.join(changed) or 'nothing changed'}")

    async def _read(self) -> tuple[Config, str, list[str]]:
        """Return the settings, checked as at the start, the SHA-256 of their file, and the changed keys.

        Raises BadInputError, and TimeoutError if the disk hangs.
        """
        async with asyncio.timeout(_READ_TIMEOUT_S):
            content = await call_in_thread(partial(read_config, self._place), "settings")
            await asyncio.sleep(_SETTLE_S)
            return await call_in_thread(partial(self._checked, content), "settings")

    def _checked(self, before: bytes) -> tuple[Config, str, list[str]]:
        content = read_config(self._place)
        if content != before:
            raise BadInputError(self._place, "is being written: reload again when it is complete")
        config = settings_of(content, self._place)
        if missing := missing_files(config):
            raise BadInputError(self._place, *map(str, missing))
        old, new = self._config.model_dump(mode="json"), config.model_dump(mode="json")
        changed = list(changed_keys(old, new))
        fixed = [key for key in changed if key.split(".")[0] not in RELOADED]
        if config.has_outbox != self._config.has_outbox:  # the history is open already
            fixed.append("mqtt.store_and_forward")
        if fixed:
            raise BadInputError(self._place, *(f"{key}: {_FIXED}" for key in fixed))
        loaded, path = self._calibration.file, config.unit.calibration
        if loaded is None or sha256(read_file(path, MAX_BYTES)).hexdigest() != loaded.sha256:
            raise BadInputError(path, "is not the file that was loaded: restart altd")
        for check in interface_checks(config):
            check()
        return config, sha256(content).hexdigest(), changed

    def _refuse(self, first: str, *more: str) -> None:
        rest = f" (and {len(more)} more: altd check-config)" if more else ""
        self._report(State.DEGRADED, f"settings refused, the old ones remain in use: {first}{rest}")

    def _report(self, state: State, text: str) -> None:
        log.info("%s", text)  # not a warning: a repeated warning is suppressed
        self._unit.events.note(EventKind.CONFIG, text)
        self._unit.health.component("settings").set_state(state, text)


def changed_keys(old: object, new: object, place: str = "") -> Iterator[str]:
    """Yield the keys that differ between two settings in plain JSON types; a list counts as one key."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in {**old, **new}:
            yield from changed_keys(old.get(name), new.get(name), f"{place}.{name}" if place else name)
    elif old != new:
        yield place
