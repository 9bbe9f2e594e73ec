"""A headless Chromium spoken to by its own protocol alone (Chrome DevTools Protocol, domains 1.3).

Playwright lets the process that draws a page keep the answers that the page gets (``Network.enable``), which
looks as if the page itself took more and more memory.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from benchmarks.chromium import program

_PATIENCE_S = 60.0
_MAX_MESSAGE_BYTES = 16 * 2**20


class DevTools:
    """One client of the protocol; it has one question under way at a time and hears no events."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self._page: str | None = None
        """The session with the page, once there is one."""

    async def open(self, url: str, before: str = "") -> None:
        """Open the page that this client asks from now on; ``before`` is a program that runs first in it."""
        target = await self.send("Target.createTarget", {"url": "about:blank"})
        attached = await self.send("Target.attachToTarget", {"targetId": target["targetId"], "flatten": True})
        self._page = attached["sessionId"]
        await self.send_to_page("Page.enable")
        await self.send_to_page("Performance.enable")
        if before:
            await self.send_to_page("Page.addScriptToEvaluateOnNewDocument", {"source": before})
        await self.send_to_page("Page.navigate", {"url": url})

    async def evaluate(self, expression: str) -> Any:
        """What an expression is worth in the page; raises RuntimeError when it fails there."""
        told = await self.send_to_page("Runtime.evaluate", {"expression": expression, "returnByValue": True})
        if "exceptionDetails" in told:
            raise RuntimeError(f"{expression}: {told['exceptionDetails']}")
        return told["result"].get("value")

    async def until(self, condition: str) -> None:
        """Wait until a condition holds in the page; raises TimeoutError."""
        async with asyncio.timeout(_PATIENCE_S):
            while not await self.evaluate(condition):  # noqa: ASYNC110  there is no event
                await asyncio.sleep(0.1)

    async def send(self, method: str, params: dict[str, Any] | None = None) -> Any:
        """What the browser answers; raises RuntimeError with what it complains of."""
        return await self._ask({"method": method, "params": params or {}})

    async def send_to_page(self, method: str, params: dict[str, Any] | None = None) -> Any:
        """What the page answers; raises RuntimeError with what it complains of."""
        return await self._ask({"method": method, "params": params or {}, "sessionId": self._page})

    async def _ask(self, question: dict[str, Any]) -> Any:
        self._number += 1
        await self._socket.send(json.dumps({"id": self._number, **question}))
        async with asyncio.timeout(_PATIENCE_S):
            async for message in self._socket:
                said = json.loads(message)
                if said.get("id") == self._number:
                    if "error" in said:
                        raise RuntimeError(f"{question['method']}: {said['error']['message']}")
                    return said["result"]
        raise RuntimeError(f"{question['method']}: the browser has gone")


@contextlib.asynccontextmanager
async def devtools(width: int, height: int) -> AsyncIterator[DevTools]:
    """A browser that lives as long as the block lasts; raises SystemExit where there is none."""
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        words = ["--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0"]
        words += [f"--user-data-dir={profile}", f"--window-size={width},{height}"]
        nothing = asyncio.subprocess.DEVNULL
        process = await asyncio.create_subprocess_exec(program(), *words, stdout=nothing, stderr=nothing)
        try:
            async with connect(await _address(Path(profile)), max_size=_MAX_MESSAGE_BYTES) as socket:
                yield DevTools(socket)
        finally:
            process.terminate()
            await process.wait()


async def _address(profile: Path) -> str:
    """Where the browser listens, which it writes down; raises TimeoutError."""
    async with asyncio.timeout(_PATIENCE_S):
        while True:
            with contextlib.suppress(FileNotFoundError, ValueError):
                port, path = (profile / "DevToolsActivePort").read_text().splitlines()
                return f"ws://127.0.0.1:{port}{path}"
            await asyncio.sleep(0.05)
