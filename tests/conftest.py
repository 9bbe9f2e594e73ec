"""What every test may use, and what no test may leave behind."""

from __future__ import annotations

import asyncio
import os
import shutil
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import pytest_asyncio

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def need(available: bool, reason: str) -> None:
    """Skip a test for a missing foreign part on a bare machine; in CI a missing part is a failure."""
    if available:
        return
    if os.environ.get("CI"):
        pytest.fail(f"CI must have it: {reason}")
    pytest.skip(reason)


def need_program(name: str) -> str:
    """The path of a foreign program, or a skip with the name of the Debian package that has it."""
    path = shutil.which(name)
    need(path is not None, f"{name} is not installed (Debian package {name})")
    assert path is not None
    return path


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The recordings and photographs that this project did not make."""
    need(SHARED_DATA.is_dir(), "../shared/data is not there")
    return SHARED_DATA


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    """A test that leaks a thread fails."""
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + 2.0
    while leaked := [t for t in threading.enumerate() if t not in before and t.is_alive()]:
        if all(t.name.startswith("asyncio_") for t in leaked):
            return  # the loop's own executor, joined when the loop closes
        if time.monotonic() > deadline:
            pytest.fail(f"threads left behind: {[t.name for t in leaked]}")
        time.sleep(0.01)


@pytest_asyncio.fixture(autouse=True)
async def no_task_is_left() -> AsyncIterator[None]:
    """A test that leaks a task fails."""
    before = asyncio.all_tasks()
    yield
    await asyncio.sleep(0)
    leaked = [task for task in asyncio.all_tasks() - before if not task.done()]
    if leaked:
        pytest.fail(f"tasks left behind: {[task.get_name() for task in leaked]}")
