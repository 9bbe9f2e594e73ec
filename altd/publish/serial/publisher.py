"""Publisher on a serial port: the telegram at its interval, or the console."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable

from altd.config import ConsolePortSettings, TelegramPortSettings
from altd.ports import Clock
from altd.publish.serial.console import Console
from altd.publish.serial.parts_text import Past
from altd.publish.serial.plate_and_row import encode, places_of, sentences_of
from altd.publish.serial.telegram import (
    LINE_END,
    Nameplate,
    identification,
    longest_bytes,
    of_now,
    with_proof,
)
from altd.serial_port.port import Port, describe, opened
from altd.status.board import Board
from altd.status.health import Component, State
from altd.status.proof import Stamps
from altd.status.unit import PublishedUnit

MAX_WAITING_BYTES = 16384
"""Maximum number of bytes of console output that wait for a slow line."""

READ_INTERVAL_S = 0.02
"""Pause after each turn: a line that floods, or echoes all it is sent, must not keep the unit busy."""

MAX_READ_BYTES = 128
"""Maximum number of typed characters per turn, and of these at most one line: a turn then occupies the event
loop for about a millisecond, whatever arrives. 6,400 characters a second are more than anybody types."""


_REQUEST = re.compile(rb"[^ -~]\?[\r\n]")
"""A line with ``?`` alone. Any byte that is not printable ASCII counts as the end of the previous line: some
transceivers send one when the line changes its direction."""


class TelegramPublisher:
    """Sends the current measurement at a fixed interval, or on request, but not more often."""

    def __init__(
        self,
        settings: TelegramPortSettings,
        board: Board,
        component: Component,
        clock: Clock,
        nameplate: Nameplate,
    ) -> None:
        self._settings = settings
        self._board = board
        self._component = component
        self._clock = clock
        self._nameplate = nameplate
        self._stamps = Stamps(board, component.name)
        self._heard = LINE_END
        self._asked = False
        """Whether a request waits; several requests get one answer."""

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the port cannot be opened or has disappeared."""
        settings, quantities = self._settings, self._board.quantities
        sentences = sentences_of(quantities.instrument, len(places_of(quantities)))
        limit = len(LINE_END) + longest_bytes(settings, sentences)
        interval_ns = round(settings.interval_s * 1e9)
        async with opened(settings, limit, fresh=True) as port:
            ready()
            self._component.set_state(State.OK, telegram_message(settings))
            self._heard, self._asked = LINE_END, False
            due_ns = self._clock.monotonic_ns()
            identify_ns = math.inf if settings.identify_every_s is None else due_ns
            lead = LINE_END  # ends a line that an unplugged cable or a crash may have cut
            while True:
                await self._until_due(port, due_ns)
                now_ns = self._clock.monotonic_ns()
                identifies = now_ns >= identify_ns
                if self._send(port, lead, identifies):
                    lead = b""
                    if identifies:
                        identify_ns = now_ns + (settings.identify_every_s or 0.0) * 1e9
                self._asked = False
                due_ns += interval_ns
                if due_ns <= now_ns or settings.on_request:  # lost time is not made up by a burst
                    due_ns = now_ns + interval_ns

    async def _until_due(self, port: Port, due_ns: int) -> None:
        """Return when the next telegram may be sent and, on request, was requested."""
        left_ns = due_ns - self._clock.monotonic_ns()
        if left_ns > 0:
            pause = asyncio.ensure_future(self._clock.sleep(left_ns * 1e-9))
            try:
                while not pause.done():
                    await self._listen(port, pause)
            finally:
                pause.cancel()
        while self._settings.on_request and not self._asked:
            await self._listen(port)

    async def _listen(self, port: Port, until: asyncio.Future[None] | None = None) -> None:
        """Search the next input for a request, even if its bytes arrive one by one."""
        heard = self._heard + await port.read(until=until)
        if len(heard) > len(self._heard):
            self._asked = self._asked or _REQUEST.search(heard) is not None
            self._heard = heard[-2:]
            await asyncio.sleep(READ_INTERVAL_S)

    def _send(self, port: Port, lead: bytes, identifies: bool) -> bool:
        measurement, age_s = self._board.read(), self._board.age_s()
        telegram = encode(measurement, self._board.quantities)
        if self._settings.sigma_now:
            telegram += of_now(measurement, age_s)
        if self._settings.checked:
            telegram = with_proof(telegram, measurement, self._stamps.next(), age_s)
        if identifies:
            telegram += identification(self._nameplate, measurement)
        sent = port.write(lead + telegram)
        self._component.count("telegrams_sent" if sent else "telegrams_dropped")
        if sent:
            self._component.gave_data()
            self._component.set_state(State.OK, telegram_message(self._settings))
        else:
            self._component.set_state(
                State.DEGRADED, "the line does not accept the telegrams: they are omitted"
            )
        return sent


class ConsolePublisher:
    """Serves the console for one person at a terminal."""

    def __init__(
        self,
        settings: ConsolePortSettings,
        unit: PublishedUnit,
        component: Component,
        past: Past | None = None,
    ) -> None:
        self._settings = settings
        self._unit = unit
        self._component = component
        self._clock = component.clock
        self._past = past

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError when the port cannot be opened or has disappeared."""
        console = Console(self._unit, self._past)
        async with opened(self._settings, limit=MAX_WAITING_BYTES, fresh=False) as port:
            ready()
            self._component.set_state(State.OK, console_message(self._settings))
            self._show(port, console.welcome())
            waiting = b""
            typed_ns = shown_ns = asked_ns = self._clock.monotonic_ns()
            while True:
                rest_ns = _due_ns(typed_ns, console.waiting_s)
                line_ns = _due_ns(shown_ns, console.watching_s)
                answer_ns = _due_ns(asked_ns, console.asking_s)
                waiting = waiting or await self._typed(port, min(rest_ns, line_ns, answer_ns))
                typed, waiting = _first_line(waiting)
                known, now_ns = console.commands, self._clock.monotonic_ns()
                if now_ns >= answer_ns:  # before input that was typed too late
                    self._show(port, console.drop_question())
                if typed:
                    was_asking = console.asking_s is not None
                    self._show(port, console.feed(typed))
                    typed_ns = now_ns
                    if not was_asking:
                        asked_ns = now_ns
                    if console.is_finding:
                        self._show(port, await console.found())
                elif now_ns >= rest_ns:
                    self._show(port, console.rest())
                if console.commands != known:
                    self._component.count("commands", console.commands - known)
                    shown_ns = now_ns
                elif now_ns >= line_ns:
                    self._show(port, console.tick())
                    shown_ns = now_ns
                if typed:
                    await asyncio.sleep(READ_INTERVAL_S)

    async def _typed(self, port: Port, until_ns: float) -> bytes:
        """Return the next bytes that are typed; empty if none arrive in time."""
        if until_ns == math.inf:
            return await port.read(limit=MAX_READ_BYTES)
        left_ns = max(until_ns - self._clock.monotonic_ns(), 0)
        pause = asyncio.ensure_future(self._clock.sleep(left_ns * 1e-9))
        try:
            return await port.read(until=pause, limit=MAX_READ_BYTES)
        finally:
            pause.cancel()

    def _show(self, port: Port, text: bytes) -> None:
        if text and not port.write(text):
            self._component.count("answers_dropped")


def telegram_message(settings: TelegramPortSettings) -> str:
    """State text of a port that sends telegrams."""
    when = "on request, at most every" if settings.on_request else "every"
    return f"telegram {when} {settings.interval_s:g} s on {describe(settings)}"


def console_message(settings: ConsolePortSettings) -> str:
    """State text of a port with a console."""
    return f"console on {describe(settings)}"


def _due_ns(since_ns: int, after_s: float | None) -> float:
    """Time at which something is due ``after_s`` after an instant; None: never."""
    return math.inf if after_s is None else since_ns + round(after_s * 1e9)


def _first_line(typed: bytes) -> tuple[bytes, bytes]:
    """The typed text up to the end of its first line, and the rest."""
    end = next((place + 1 for place, byte in enumerate(typed) if byte in LINE_END), len(typed))
    return typed[:end], typed[end:]
