"""Test files are run in the order of their time in earlier runs: one that takes minutes does not begin last.

The times are kept between runs; they change only the order of files.
"""

from __future__ import annotations

import collections
import json
import os
from typing import Any

import pytest

from support.places import CACHE

TIMES_S = CACHE / "test-times.json"
_UNKNOWN_S = 10.0
"""For a file that was not run before."""


class LongestFirst:
    """Orders the files in each worker of a run; the process that starts the workers keeps the times."""

    def __init__(self, times_s: dict[str, float]) -> None:
        self._times_s = times_s
        self._taken_s: collections.Counter[str] = collections.Counter()

    @classmethod
    def of(cls, config: pytest.Config) -> LongestFirst:
        """The order for this process: all workers have that of the process which started them."""
        config.option.loadscopereorder = False
        given = getattr(config, "workerinput", {}).get("times_s")
        if given is not None:
            return cls(given)
        try:
            return cls({str(file): float(time_s) for file, time_s in json.loads(TIMES_S.read_text()).items()})
        except (OSError, ValueError, AttributeError, TypeError):  # none yet, or damaged
            return cls({})

    def pytest_configure_node(self, node: Any) -> None:
        """Give a worker the times."""
        node.workerinput["times_s"] = self._times_s

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort by file; the order within a file stays."""
        items.sort(key=lambda item: -self._times_s.get(_file_of(item.nodeid), _UNKNOWN_S))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the time of a test with its fixtures to that of its file."""
        self._taken_s[_file_of(report.nodeid)] += report.duration

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Keep the times; after a part of a file's tests at least half of its former time."""
        if hasattr(session.config, "workerinput"):
            return
        former_s = self._times_s
        taken_s = {
            file: round(max(time_s, former_s.get(file, 0) / 2), 2) for file, time_s in self._taken_s.items()
        }
        try:
            TIMES_S.parent.mkdir(parents=True, exist_ok=True)
            new = TIMES_S.with_suffix(f".{os.getpid()}")
            new.write_text(json.dumps(former_s | taken_s, indent=0))
            new.replace(TIMES_S)
        except OSError:
            pass  # the order is not worth a failed run


def _file_of(nodeid: str) -> str:
    return nodeid.split("::")[0]
