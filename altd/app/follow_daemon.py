"""A thread that asks the running daemon again and again, and hands over what it hears."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from functools import partial

from altd.app.ask_daemon import RunningDaemon
from altd.local_socket.asking import NoAnswerError
from altd.terminal.knowledge import Knowledge

READING_INTERVAL_S = 0.2
STATUS_INTERVAL_S = 0.5
SELDOM_INTERVAL_S = 5.0
_MAX_HEARD = 64
"""Answers that wait for who shows them; while nobody takes any, later ones are dropped."""

Telling = Callable[[Knowledge], None]


class Follower:
    """Asks while it is entered; ``tell`` hands on what was heard meanwhile."""

    def __init__(self, daemon: RunningDaemon) -> None:
        self._daemon = daemon
        self._heard: queue.Queue[Telling] = queue.Queue(_MAX_HEARD)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="follow the daemon", daemon=True)

    def __enter__(self) -> Follower:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(timeout=2 * self._daemon.timeout_s)

    def tell(self, knowledge: Knowledge) -> None:
        """Hand over all that was heard since."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._heard.get_nowait()(knowledge)

    def _follow(self) -> None:
        due_status_s = due_seldom_s = 0.0
        while not self._end.is_set():
            begun_s = time.monotonic()
            try:
                self._ask_reading()
                if begun_s >= due_seldom_s:
                    self._ask_seldom()
                    due_seldom_s = begun_s + SELDOM_INTERVAL_S
                if begun_s >= due_status_s:
                    self._ask_status()
                    due_status_s = begun_s + STATUS_INTERVAL_S
            except NoAnswerError as error:
                due_status_s = due_seldom_s = 0.0
                self._put(partial(Knowledge.hear_nothing, why=str(error)))
            self._end.wait(max(begun_s + READING_INTERVAL_S - time.monotonic(), 0.05))

    # An answer counts from when it was asked for: it may have waited on its way.

    def _ask_reading(self) -> None:
        asked_s = time.monotonic()
        reading, _ = self._daemon.reading()
        self._put(lambda knowledge: knowledge.hear_reading(reading, asked_s))

    def _ask_status(self) -> None:
        asked_s = time.monotonic()
        status, _ = self._daemon.status()
        self._put(lambda knowledge: knowledge.hear_status(status, asked_s))

    def _ask_seldom(self) -> None:
        check, _ = self._daemon.self_check()
        targets, _ = self._daemon.targets()
        self._put(lambda knowledge: knowledge.hear_about(check, targets))

    def _put(self, telling: Telling) -> None:
        with contextlib.suppress(queue.Full):
            self._heard.put_nowait(telling)
