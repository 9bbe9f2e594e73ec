"""The process of the server, a child of the daemon.

It receives the listening socket as a descriptor and lines of JSON on standard input, and answers in lines of
JSON on standard output. It ends when its standard input ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import os
import resource
import socket
import sys
import time
from collections import Counter
from typing import Any
from urllib.parse import quote

from asyncua import ua

from altd.credentials.file import CredentialsKeeper
from altd.errors import BadInputError
from altd.history.history import History
from altd.publish.opcua.history import StoredValues
from altd.publish.opcua.live import LiveUnit
from altd.publish.opcua.nodes import UnitNodes
from altd.publish.opcua.server import OpcUaServer
from altd.publish.opcua.sessions import caller
from altd.publish.opcua.standard import fill_standard_nodes
from altd.publish.opcua.start import Start

NICE = 10
MAX_MEMORY_BYTES = 384 << 20
"""Maximum data (RLIMIT_DATA): clients that exhaust the memory end this process, not the unit."""
MAX_LINE_BYTES = 1 << 18
CHECK_INTERVAL_S = 0.1
FIGURES_INTERVAL_S = 1.0
ANSWER_TIMEOUT_S = 5.0

_POLICIES = (
    ua.SecurityPolicyType.Basic256Sha256_Sign,
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_Sign,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)


class ServedUnit:
    """The unit's server: its nodes, their live values, stored values, and requests for a self-check."""

    def __init__(self, start: Start, listener: socket.socket, monotonic_ns: Any = time.monotonic_ns) -> None:
        """Raises BadInputError for credentials that cannot be used."""
        path = start.settings.credentials
        self._start = start
        self.server = OpcUaServer(listener, None if path is None else CredentialsKeeper(path))
        self.nodes = UnitNodes(self.server, start)
        self.live = LiveUnit(self.nodes, start, monotonic_ns)
        self._history = History(start.history, "this unit keeps no history", start.serial)
        self._requests: list[asyncio.Future[str]] = []

    async def begin(self) -> None:
        """Build the address space and start serving."""
        start, server, settings = self._start, self.server, self._start.settings
        await server.init()
        await server.set_application_uri(f"urn:altd:{quote(start.serial, safe='')}")
        server.name, server.product_uri = f"{start.product} {start.serial}", "urn:altd"
        server.application_type = ua.ApplicationType.Server
        now = ua.get_win_epoch()
        await server.set_build_info(server.product_uri, "", "altd", start.version, "", now)
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        server.set_endpoint(f"opc.tcp://{host}:{start.port}/altd")
        if settings.certificate is not None and settings.key is not None:
            await server.load_certificate(settings.certificate, "pem")
            await server.load_private_key(settings.key, format="pem")
            server.set_security_policy(list(_POLICIES))
        else:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await self.nodes.build()
        await fill_standard_nodes(server, start)
        stored = StoredValues(self._history, start, self.nodes.quantity_of)
        server.limited.read_history, server.limited.withdraw_stale = stored.read, self.live.withdraw_stale
        if settings.allow_self_check:
            await self.nodes.add_method("SelfCheck", "ask the unit for a self-check", self._self_check)
        await server.start()

    async def end(self) -> None:
        """Stop serving."""
        await self.server.stop()
        await self._history.end()

    async def take(self, line: bytes) -> None:
        """Process a line of the daemon: a measurement, the state, or the answer to a self-check request."""
        if not line.startswith(b'{"self_check"'):
            await self.live.take(line)
        elif self._requests:
            asked = self._requests.pop(0)
            if not asked.done():
                asked.set_result(json.loads(line)["self_check"])

    @property
    def has_clients(self) -> bool:
        """Whether a client is connected; without a client the daemon sends less."""
        return self.server.bserver is not None and bool(self.server.bserver.clients)

    def figures(self) -> dict[str, float]:
        """Return the figures of the server that the daemon shows."""
        limited, server = self.server.limited, self.server.bserver
        with open("/proc/self/statm", encoding="ascii") as statm:  # noqa: PTH123  a file of the kernel
            rss_bytes = int(statm.read().split()[1]) * resource.getpagesize()
        return {
            "clients": len(server.clients) if server is not None else 0,
            "subscriptions": len(limited.subscription_service.subscriptions),
            "monitored_items": sum(len(each.items) for each in limited.sessions.values()),
            "refused": Counter(limited.refused).total(),
            "lines_refused": self.live.lines_refused,
            "rss_mb": round(rss_bytes / 1e6, 1),
        }

    async def _self_check(self, _: ua.NodeId) -> ua.StatusCode:
        """Request a self-check and wait for the daemon's answer; empty text: the check will run."""
        if len(self._requests) >= 1:
            return ua.StatusCode(ua.StatusCodes.BadTooManyOperations)
        asked = asyncio.get_running_loop().create_future()
        self._requests.append(asked)
        send({"self_check": caller.get()})
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                refusal = await asked
        except TimeoutError:
            return ua.StatusCode(ua.StatusCodes.BadTimeout)
        return ua.StatusCode(ua.StatusCodes.BadInvalidState if refusal else ua.StatusCodes.Good)


def send(document: dict[str, Any]) -> None:
    """Send a line to the daemon."""
    print(json.dumps(document), flush=True)  # noqa: T201  the pipe


async def serve(descriptor: int) -> None:
    """Serve until standard input ends. Raises BadInputError, OSError, ValueError."""
    reader = asyncio.StreamReader(MAX_LINE_BYTES)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    unit = ServedUnit(Start.from_line(await reader.readline()), socket.socket(fileno=descriptor))
    await unit.begin()
    gc.collect()
    gc.freeze()
    send({"serving": True})
    keeping = asyncio.create_task(_keep(unit))
    try:
        while line := await reader.readline():
            await unit.take(line)
            if keeping.done():
                keeping.result()  # it ends only with an error
    finally:
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await unit.end()


async def _keep(unit: ServedUnit) -> None:
    """Withdraw stale values, and report the state of the server to the daemon."""
    due_s, had_clients = time.monotonic(), False
    changed = unit.server.limited.clients_changed
    while True:
        changed.clear()
        await unit.live.withdraw_stale()
        if (has_clients := unit.has_clients) != had_clients:
            had_clients = has_clients
            send({"has_clients": has_clients})
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + FIGURES_INTERVAL_S
            unit.server.close_idle()
            send({"figures": unit.figures()})
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CHECK_INTERVAL_S):
                await changed.wait()


def run(descriptor: int) -> int:
    """Serve; return 0 at the end, 2 for files that cannot be used. Other exceptions end it with status 1."""
    with contextlib.suppress(OSError):  # not permitted in some services: the administrator's limits apply
        os.nice(NICE)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    logging.disable()  # asyncua logs what clients send
    try:
        asyncio.run(serve(descriptor))
    except BrokenPipeError:
        return 0
    except (BadInputError, OSError, ValueError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0
