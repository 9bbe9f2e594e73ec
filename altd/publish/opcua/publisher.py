"""Runs the server in a separate process, and sends measurements and state to it.

asyncua parses requests in Python: in the daemon's process, a browsing client would delay the measurement.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import logging
import math
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable
from importlib.util import find_spec

from altd.config import Installation, OpcUaSettings
from altd.credentials.certificates import server_context
from altd.credentials.file import load_credentials
from altd.errors import BadInputError, one_line, unwrap_group
from altd.history.history import History
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M
from altd.instruments.beam.instrument import QUANTITIES as OF_BEAM
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.publish.opcua.start import Start
from altd.status.cause import StateReport
from altd.status.health import Component, State
from altd.status.measurement_json import checked_line, with_proof
from altd.status.models import state_of
from altd.status.proof import Stamps
from altd.status.services import NoSelfCheckError
from altd.status.target_area import AREA_MM
from altd.status.unit import PublishedUnit
from altd.tcp_port import listen

MAX_INTERVAL_S = 0.5
"""Maximum time between two measurements for the server; without a client also the minimum."""
STATE_INTERVAL_S = 1.0
"""Maximum time between two state messages; the state is also sent when it changes."""
TAKE_TIMEOUT_S = 10.0
"""Time after which a server that reads nothing, or sends nothing, is restarted."""
START_TIMEOUT_S = 180.0
"""The start takes seconds of a processor, which a busy computer gives to other programs first."""
END_TIMEOUT_S = 2.0
PIPE_BYTES = 4096
"""Maximum size of lines that wait in the kernel: two measurements; more would be old when they are read."""
MAX_LINE_BYTES = 1 << 16
MAX_ERROR_LINES = 20

log = logging.getLogger("altd")


class ServerError(Exception):
    """The process of the server has ended, or hangs; the message gives the reason."""


def check_opcua(settings: OpcUaSettings) -> None:
    """Raise BadInputError if the server's package is missing, or a file cannot be used."""
    if find_spec("asyncua") is None:
        raise BadInputError("[opcua]", "needs asyncua, which comes with the extra: pip install 'altd[opcua]'")
    if settings.credentials is not None:
        load_credentials(settings.credentials)
    if settings.certificate is not None and settings.key is not None:
        server_context(settings.certificate, settings.key)


class OpcUaPublisher:
    """Serves OPC UA. Raises BadInputError as ``check_opcua`` does.

    A server that does not read its lines loses measurements, which are counted: it receives only the newest.
    """

    def __init__(
        self,
        settings: OpcUaSettings,
        unit: PublishedUnit,
        component: Component,
        history: History,
        installation: Installation = Installation(),  # noqa: B008  frozen
    ) -> None:
        check_opcua(settings)
        self.port = settings.port
        """Port of the server; for port 0 in the settings, the port that the system chose."""
        self.process: Process | None = None
        self._settings = settings
        self._unit = unit
        self._board = unit.board
        self._component = component
        self._history = history
        self._installation = installation
        self._stamps = Stamps(unit.board, component.name)
        self._patience_s = START_TIMEOUT_S
        self._answers: list[str] = []
        self._has_clients = asyncio.Event()

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError for an address, ServerError when the server has ended."""
        with listen(self._settings.host, self._settings.port) as listener:
            self.port = listener.getsockname()[1]
            listener.setblocking(False)
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "altd.publish.opcua", str(listener.fileno()), str(os.getpid())),
                stdin=PIPE,
                stdout=PIPE,
                stderr=PIPE,
                pass_fds=[listener.fileno()],
                limit=MAX_LINE_BYTES,
            )
        self.process, self._patience_s = process, START_TIMEOUT_S
        self._has_clients.clear()
        said: list[str] = []
        errors = asyncio.create_task(self._errors(process, said), name="opcua errors")
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._send(process), name="opcua lines")
                tasks.create_task(self._listen(process, ready), name="opcua answers")
        except BaseExceptionGroup as group:
            if (ended := unwrap_group(group, ServerError, ConnectionError)) is None:
                raise
            if isinstance(ended, ConnectionError):
                await self._end(process)
                await errors
                ended = ServerError(said[-1] if said else f"it has ended with status {process.returncode}")
            raise ended from None
        finally:
            await self._end(process)
            await errors

    async def _end(self, process: Process) -> None:
        """End the process by closing its input; kill it if it does not end in time."""
        if process.stdin is not None:
            process.stdin.close()
        try:
            async with asyncio.timeout(END_TIMEOUT_S):
                await process.wait()
        except (TimeoutError, asyncio.CancelledError) as error:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
            if isinstance(error, asyncio.CancelledError):
                raise

    async def _send(self, process: Process) -> None:
        """Send one line after the other, each created when the previous one was read."""
        assert process.stdin is not None  # noqa: S101  a pipe
        pipe = process.stdin
        pipe.transport.set_write_buffer_limits(high=0)
        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe.get_extra_info("pipe"), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        pipe.write(self._start().to_line())
        cursor, sent, due_ns = self._board.cursor(), None, 0
        while True:
            try:
                async with asyncio.timeout(self._patience_s):
                    await pipe.drain()
            except TimeoutError:
                raise ServerError("it does not respond: it reads no measurements") from None
            is_read, skipped = self._has_clients.is_set(), cursor.skipped
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(MAX_INTERVAL_S):
                    await self._has_clients.wait()
                    await cursor.next()
            if is_read:
                self._component.count("measurements_skipped", cursor.skipped - skipped)
            else:
                cursor = self._board.cursor()
            for answer in self._answers:
                pipe.write(json.dumps({"self_check": answer}).encode() + b"\n")
            self._answers.clear()
            if (measurement := self._board.read()) is not None:
                pipe.write(checked_line(self._board, measurement, self._stamps.next()).encode() + b"\n")
            state, now_ns = self._unit.state(), self._component.clock.monotonic_ns()
            if (shown := _shown(state)) != sent or now_ns >= due_ns:
                sent, due_ns = shown, now_ns + round(STATE_INTERVAL_S * 1e9)
                document = {} if state is None else state_of(state).as_object()
                pipe.write(with_proof(document, self._board, self._stamps.next()).encode() + b"\n")

    def _start(self) -> Start:
        board, view = self._board, self._unit.view()
        return Start(
            settings=self._settings,
            port=self.port,
            serial=view.facts.serial,
            product=view.facts.product,
            version=view.facts.version,
            session=f"{view.identity.session or 0:08X}",
            started_ns=view.now_ns - view.running_ns,
            stale_after_s=board.stale_after_s,
            quantities=view.quantities,
            ranges=ranges_of(self._installation),
            targets={each.place: {} for each in view.quantities.of_unit if each.place}
            | {
                area.name: {
                    key: (min(at), max(at))
                    for key, at in zip(("x_mm", "y_mm"), zip(*area.valid_mm, strict=True), strict=True)
                }
                for area in view.targets
            },
            calibration=view.calibration_identity.as_object(),
            history=self._history.path,
            declared=(*OF_BEAM.of_unit, *OF_PLATE.of_unit),
        )

    async def _listen(self, process: Process, ready: Callable[[], None]) -> None:
        assert process.stdout is not None  # noqa: S101  a pipe
        while True:
            try:
                async with asyncio.timeout(self._patience_s):
                    line = await process.stdout.readline()
            except (TimeoutError, ValueError):
                raise ServerError("it does not respond, or sends too much") from None
            if not line:
                raise ConnectionResetError
            document = json.loads(line)
            if "serving" in document:
                self._patience_s = TAKE_TIMEOUT_S
                ready()
                self._component.set_state(State.OK, f"port {self.port}{_openness(self._settings)}")
            elif "has_clients" in document:
                (self._has_clients.set if document["has_clients"] else self._has_clients.clear)()
            elif "figures" in document:
                self._component.is_alive()
                self._component.observe(document["figures"])
            elif "self_check" in document:
                self._answers.append(self._ask(document["self_check"]))

    def _ask(self, by: str) -> str:
        """Request a self-check; return the reason of a refusal, or an empty text."""
        if not self._settings.allow_self_check:
            return "not allowed"
        try:
            self._unit.self_check.ask(one_line(by))
        except NoSelfCheckError as error:
            return str(error)
        return ""

    async def _errors(self, process: Process, said: list[str]) -> None:
        """Log the server's lines on standard error; ``said`` receives the last one, the reason of its end."""
        assert process.stderr is not None  # noqa: S101  a pipe
        lines = 0
        while piece := await process.stderr.read(MAX_LINE_BYTES):
            for line in piece.decode(errors="replace").splitlines():
                lines += 1
                if line.strip():
                    said[:] = [one_line(line.strip())]
                if lines <= MAX_ERROR_LINES:
                    log.warning("%s: %s", self._component.name, one_line(line))


def _shown(report: StateReport | None) -> object:
    if report is None:
        return None
    return report.signal, [(shown.cause.kind, shown.cause.of, shown.is_active) for shown in report.causes]


def _openness(settings: OpcUaSettings) -> str:
    """Text about encryption and the networks that can read here."""
    if settings.certificate is None:
        return ", without encryption, open to every network that reaches it"
    return "" if settings.credentials is not None else ", encrypted, open to every network that reaches it"


def ranges_of(installation: Installation) -> dict[str, tuple[float, float]]:
    """Ranges that are stated for the unit, in its reference plane and with its mounting offsets."""
    ranges = {"roll_deg": (-180.0, 180.0)}
    lever_m = abs(installation.reference_plane_mm) / 1000
    for key, offset, half in (
        ("x_mm", installation.offset_x_mm, AREA_MM[0] / 2 + lever_m * MAX_YAW_MM_PER_M),
        ("y_mm", installation.offset_y_mm, AREA_MM[1] / 2 + lever_m * MAX_PITCH_MM_PER_M),
        ("yaw_deg", installation.offset_yaw_deg, math.degrees(math.atan(MAX_YAW_MM_PER_M / 1000))),
        ("pitch_deg", installation.offset_pitch_deg, math.degrees(math.atan(MAX_PITCH_MM_PER_M / 1000))),
    ):
        ranges[key] = (offset - half, offset + half)
    for angle in ("yaw", "pitch"):
        low, high = ranges[f"{angle}_deg"]
        ranges[f"{angle}_mm_per_m"] = (
            1000 * math.tan(math.radians(low)),
            1000 * math.tan(math.radians(high)),
        )
    return ranges
