"""A screenshot of a page in Chromium over its DevTools pipe: the page may go on loading, as a stream."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_COMMANDS_FD, _ANSWERS_FD = 3, 4
"""Where Chromium's ``--remote-debugging-pipe`` reads and writes, JSON that ends in NUL."""


def screenshot(address: str, picture: Path, profile: Path, width: int, height: int, after_s: float) -> None:
    """Write a PNG of the page some seconds after it was opened; ``width`` and ``height`` in CSS px.

    ``profile`` is a folder for the browser. Raises RuntimeError when the browser does not do its part.
    """
    with _browser(profile) as browser:
        target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        size = {"width": width, "height": height, "deviceScaleFactor": 1.5, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", session, **size)
        browser.call("Page.navigate", session, url=address)
        time.sleep(after_s)
        still = browser.call("Page.captureScreenshot", session, format="png")
        picture.write_bytes(base64.b64decode(still["data"]))


class _Browser:
    def __init__(self, commands: int, answers: int) -> None:
        self._commands, self._answers = commands, answers
        self._numbers = itertools.count(1)
        self._received = b""

    def call(self, method: str, session: str | None = None, **parameters: object) -> dict[str, Any]:
        """Ask, and wait for the answer."""
        number = next(self._numbers)
        question: dict[str, object] = {"id": number, "method": method, "params": parameters}
        if session is not None:
            question["sessionId"] = session
        os.write(self._commands, json.dumps(question).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._received:
            more = os.read(self._answers, 1 << 20)
            if not more:
                raise RuntimeError("the browser went away")
            self._received += more
        message, _, self._received = self._received.partition(b"\0")
        answer: dict[str, Any] = json.loads(message)
        return answer


@contextlib.contextmanager
def _browser(profile: Path) -> Iterator[_Browser]:
    commands_out, commands_in = os.pipe()
    answers_out, answers_in = os.pipe()
    command = [
        "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
        f"--user-data-dir={profile}", "--remote-debugging-pipe",
    ]  # fmt: skip
    shell = f'exec "$@" {_COMMANDS_FD}<&{commands_out} {_ANSWERS_FD}>&{answers_in}'
    process = subprocess.Popen(  # noqa: S603
        ["/bin/bash", "-c", shell, "bash", *command],
        pass_fds=(commands_out, answers_in),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(commands_out)
    os.close(answers_in)
    try:
        yield _Browser(commands_in, answers_out)
    finally:
        process.terminate()
        process.wait()
        os.close(commands_in)
        os.close(answers_out)
