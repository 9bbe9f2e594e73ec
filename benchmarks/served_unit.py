"""A whole unit on cameras that deliver from memory: with history and kept frames, Modbus TCP and HTTP."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from altd.app.daemon import Daemon
from altd.app.keeping import FILE_NAME, history_about
from altd.config import KeptFrames
from altd.status.health import State
from benchmarks.material import FPS, Material, Source, make_config
from hw_sim.ports import free_port

_MAX_HISTORY_BYTES = 400 * 10**6
_PATIENCE_S = 120.0


@dataclass(frozen=True, slots=True)
class ServedUnit:
    """The daemon in this process, its cameras, and where it is read."""

    daemon: Daemon
    source: Source
    modbus_port: int
    http_port: int


@contextlib.asynccontextmanager
async def served_unit(material: Material, folder: Path) -> AsyncIterator[ServedUnit]:
    """It runs for as long as the block lasts, and measures; a history that lies in ``folder`` goes on."""
    modbus_port, http_port = free_port(), free_port()
    config = make_config(modbus_port, http_port).model_copy(
        update={"kept_frames": KeptFrames(folder=folder / "kept")}
    )
    source = Source(material, FPS)
    daemon = Daemon(config, material.calibration, source.cameras)
    about = history_about(config, material.calibration, daemon.board.quantities)
    daemon.past.keep_in(folder / FILE_NAME, _MAX_HISTORY_BYTES, about)
    task = asyncio.create_task(daemon.run(), name="daemon")
    try:
        async with asyncio.timeout(_PATIENCE_S):
            while not _is_serving(daemon):  # noqa: ASYNC110  there is no event
                await asyncio.sleep(0.05)
        yield ServedUnit(daemon, source, modbus_port, http_port)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _is_serving(daemon: Daemon) -> bool:
    """Whether there is a valid measurement, and who can be asked for it."""
    measurement = daemon.board.read()
    faces = [part for part in daemon.health if part.name.startswith(("http ", "modbus_tcp "))]
    is_listening = len(faces) == 2 and all(part.state is State.OK for part in faces)
    return is_listening and measurement is not None and measurement.valid
