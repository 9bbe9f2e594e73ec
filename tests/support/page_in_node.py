"""Scripts of the page, run by Node.js; the network and the clock are the test's."""

import contextlib
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from altd.publish.http.answers import page_files
from support.foreign import need_program


class Driven:
    """Scripts in a process of their own; each order gives back what they then show."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    @classmethod
    @contextlib.contextmanager
    def driven(cls, driver: Path, folder: Path, *names: str) -> Iterator[Self]:
        """Some of the page's scripts, copied to a folder, by a driver."""
        for name in names:
            (folder / f"{name}.mjs").write_bytes(page_files()[f"{name}.js"].content)
        command = [need_program("node", "nodejs"), str(driver), str(folder)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            yield cls(process)
            process.kill()

    def do(self, **order: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        shown: dict[str, Any] = json.loads(self._process.stdout.readline())
        return shown
