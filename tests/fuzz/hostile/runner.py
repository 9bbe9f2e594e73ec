"""Serves an interface, has it attacked, and reads it meanwhile."""

import asyncio
import logging
import random
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from fuzz.hostile import broker, frames, modbus, requests, served, typing_at
from fuzz.hostile.readers import look, poll
from fuzz.hostile.requests import Address
from fuzz.hostile.tally import MAX_WRONG, Tally
from fuzz.served import Said

from benchmarks.process_memory import resident_mb

PROCESSES = 2
POLL_INTERVAL_S = 0.02

_GONE_S = 15.0
"""Within so long nothing may be left of the last connection; the longest wait of a unit is 10 s."""

Send = Callable[[Address, random.Random], tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Front:
    """An interface on a socket: how it is served and attacked, from how many threads a process."""

    serve: Callable[[Path], AbstractAsyncContextManager[served.Served]]
    send: Send
    threads: int
    poll: Callable[[Address, Tally], Awaitable[None]] = poll


FRONTS = {
    "http": Front(served.http, requests.send, 16),
    "websocket": Front(served.websocket, frames.send, 8),  # with the viewer, one more than is admitted
    "local": Front(served.local, requests.send, 16),
    "modbus": Front(served.modbus, modbus.send, 8, modbus.poll),
}
ATTACKS = {"console": typing_at.attack, "mqtt": broker.attack}
"""Those of which this process is the far end."""
FACES = (*FRONTS, *ATTACKS)


async def run(face: str, inputs: int, seed: int = 1) -> Tally:
    """So many hostile inputs at one of ``FACES``."""
    tally, said = Tally(), Said()
    before_mb, began_s = resident_mb(), time.monotonic()
    logging.getLogger().addHandler(said)
    try:
        if face in ATTACKS:
            await ATTACKS[face](inputs, seed, tally)
            tally.seconds = time.monotonic() - began_s
        else:
            with tempfile.TemporaryDirectory() as folder:
                await _attack(face, inputs, seed, tally, Path(folder))
    finally:
        logging.getLogger().removeHandler(said)
    tally.wrong += [f"logged: {line}" for line in said.lines]
    tally.memory_mb = before_mb, resident_mb()
    return tally


async def _attack(face: str, inputs: int, seed: int, tally: Tally, folder: Path) -> None:
    front, ended = FRONTS[face], asyncio.Event()
    async with front.serve(folder) as unit:
        await front.poll(unit.address, tally)
        files, began_s = _open_files(), time.monotonic()
        with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
            loop = asyncio.get_running_loop()
            attacks = [
                loop.run_in_executor(
                    pool, attack, face, unit.address, inputs // PROCESSES, seed * PROCESSES + number
                )
                for number in range(PROCESSES)
            ]
            watching = []
            if face == "websocket" and isinstance(unit.address, tuple):
                watching.append(asyncio.create_task(look(unit.address, tally, ended)))
            while not all(each.done() for each in attacks):
                await front.poll(unit.address, tally)
                await asyncio.sleep(POLL_INTERVAL_S)
            tally.seconds = time.monotonic() - began_s
            ended.set()
            await asyncio.gather(*watching)
            for answers, wrong in await asyncio.gather(*attacks):
                tally.answers.update(answers)
                tally.wrong += wrong
        tally.wrong += await _left(unit, files)
        await front.poll(unit.address, tally)


async def _left(unit: served.Served, files: int) -> list[str]:
    """The remains of connections that have ended, some time after the last one."""
    give_up_s = time.monotonic() + _GONE_S
    while True:
        counts = {"descriptors": max(_open_files() - files, 0), **unit.left()}
        left = [f"{count} {name} are left" for name, count in counts.items() if count]
        if not left or time.monotonic() > give_up_s:
            return left
        await asyncio.sleep(0.1)


def _open_files() -> int:
    """Descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def attack(face: str, address: Address, inputs: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Send from some threads; returns how the unit answered, and what was wrong with that."""
    front, answers, wrong, lock = FRONTS[face], Counter[str](), list[str](), threading.Lock()

    def send(number: int) -> None:
        chance = random.Random(seed * front.threads + number)
        mine = Counter[str]()
        for _ in range(inputs // front.threads):
            how, why = front.send(address, chance)
            mine[how] += 1
            if why:
                with lock:
                    wrong.append(why)
        with lock:
            answers.update(mine)

    threads = [threading.Thread(target=send, args=(number,)) for number in range(front.threads)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers, wrong[:MAX_WRONG]
