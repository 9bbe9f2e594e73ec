"""Hostile typing at consoles, over pseudo terminals, beside a console that is used well."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import time

from fuzz.hostile.served import console
from fuzz.hostile.tally import Tally
from fuzz.targets.console import CONTROL

from altd.publish.serial.commands import COMMANDS
from altd.publish.serial.keys import PASTE_TIMEOUT_S

CONSOLES = 16

_TURN_S = 0.021
"""The console rests 0.02 s after each line."""

_PATIENCE_S = 20.0
_PAUSE_S = 0.5
_CHECK_EVERY = 200
_LEAVE = b"\x03q\x15\r\x15\r"
_PROMPT = b"\r\n> "

_STRANGE = (
    *(b"\x1b[A", b"\x1bOP", b"\x1b[200~", b"\x1b[201~", b"\x1b]0;x\x07", b"\xff\xfb\x01", b"\xff\xfa\x18"),
    *(b"\x03", b"\x15", b"\x7f\x7f", b"\x00", b"\xe4", b"\xc3\xa4", b"\x8d", b"\x80\xfe", b"%s%n", b"';--"),
    *(b"../..", b"\xf0\x9f\x92\xa5", b"\x1b", b"\x1b[", b"\n", b"\r", b" ", b"y", b"1e400", b"nan", b"-1"),
    *(b"all", b"now", b"x" * 200),
)
_VERSION = b"version\r\naltd 0.1.0, unit ALT-0007\r\n> "
_MEASURED = b"  x          10.012 mm  +/- 0.004"


class Terminal:
    """The far end of a console's line; all that is shown is kept until it is taken."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._shown = bytearray()

    def __enter__(self) -> Terminal:
        asyncio.get_running_loop().add_reader(self._descriptor, self._read)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.get_running_loop().remove_reader(self._descriptor)

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._shown += os.read(self._descriptor, 65536)

    def take(self) -> bytes:
        """The text shown since the last call."""
        shown = bytes(self._shown)
        self._shown.clear()
        return shown

    async def type(self, keys: bytes) -> None:
        """At the speed that the console takes."""
        while keys:
            try:
                keys = keys[os.write(self._descriptor, keys) :]
            except BlockingIOError:
                await asyncio.sleep(_TURN_S)

    async def answer(self, keys: bytes, awaited: bytes) -> bytes:
        """The text shown until ``awaited`` is, or until the timeout."""
        self.take()
        await self.type(keys)
        shown, give_up_s = b"", time.monotonic() + _PATIENCE_S
        while awaited not in shown and time.monotonic() < give_up_s:
            await asyncio.sleep(_TURN_S)
            shown += self.take()
        return shown

    async def leave(self, number: int) -> None:
        """Get out of whatever was begun: a line, pages, a question; a word shows that all of it was taken."""
        await asyncio.sleep(PASTE_TIMEOUT_S + _TURN_S)
        word = b"w%d" % number
        await self.answer(_LEAVE + word, word)
        if _PROMPT not in await self.answer(b"\x15\r", _PROMPT):  # a busy console gave the paste up later
            await self.answer(b"\x15\r", _PROMPT)


def hostile_keys(chance: random.Random) -> bytes:
    """A command with keys that are typed by mistake, corrupted here and there."""
    words = [chance.choice(list(COMMANDS)).encode(), *chance.choices(_STRANGE, k=chance.randrange(4))]
    keys = bytearray(b" ".join(words) + b"\r" * chance.randrange(2))
    for _ in range(chance.randrange(3)):
        keys[chance.randrange(len(keys))] = chance.randrange(256)
    return bytes(keys)


async def attack(inputs: int, seed: int, tally: Tally) -> None:
    """So many hostile inputs at all consoles but one, at which a user asks and is answered."""
    ended = asyncio.Event()
    async with contextlib.AsyncExitStack() as consoles:
        terminals = []
        for _ in range(CONSOLES):
            terminal = Terminal(await consoles.enter_async_context(console()))
            terminals.append(consoles.enter_context(terminal))
        good, *attacked = terminals
        asking = asyncio.create_task(_ask(good, tally, ended))
        share = inputs // len(attacked)
        await asyncio.gather(
            *(
                _type(terminal, share, random.Random(seed * CONSOLES + number), tally)
                for number, terminal in enumerate(attacked)
            )
        )
        ended.set()
        await asking


async def _type(terminal: Terminal, inputs: int, chance: random.Random, tally: Tally) -> None:
    typed = b""
    for number in range(1, inputs + 1):
        keys = hostile_keys(chance)
        typed = (typed + keys)[-400:]
        await terminal.type(keys)
        await asyncio.sleep(_TURN_S)
        shown = terminal.take()
        tally.answers["shown" if shown else "silent"] += 1
        if found := CONTROL.search(shown):
            tally.wrong.append(f"a terminal was sent {found[0]!r}; typed {typed!r}")
        if number % _CHECK_EVERY == 0 or number == inputs:
            await terminal.leave(number)
            shown = await terminal.answer(b"version\r", _VERSION)
            if not shown.endswith(_VERSION):
                tally.wrong.append(f"the next person was answered {shown[-200:]!r}; typed {typed!r}")


async def _ask(terminal: Terminal, tally: Tally, ended: asyncio.Event) -> None:
    """A person who asks for the measurement twice a second."""
    await terminal.answer(b"\r", _PROMPT)
    while not ended.is_set():
        began_s = time.monotonic()
        shown = await terminal.answer(b"measure\r", _MEASURED)
        if _MEASURED in shown:
            tally.polled(time.monotonic() - began_s)
            await asyncio.sleep(_PAUSE_S)
        else:
            tally.wrong.append(f"who asked was answered {shown[-200:]!r}")
