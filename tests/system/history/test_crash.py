"""The daemon's history is killed while it writes, again and again: `make bench-history` does so 200 times."""

from __future__ import annotations

import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from benchmarks.history_crash import MAX_LOST_S, Loss, kill_once

KILLS, FILES = 40, 2


@pytest.mark.real_time
def test_a_killed_daemon_loses_less_than_a_second_and_never_the_file(tmp_path: Path) -> None:
    draw = random.Random(7)
    after_s = [[draw.uniform(0.0, 1.5) for _ in range(KILLS // FILES)] for _ in range(FILES)]

    def killed(file: int) -> list[Loss]:
        return [kill_once(tmp_path / f"{file}.db", number, s) for number, s in enumerate(after_s[file])]

    with ThreadPoolExecutor(FILES) as each:
        losses = [loss for of_file in each.map(killed, range(FILES)) for loss in of_file]
    assert len(losses) == KILLS
    assert sum(loss.published for loss in losses) > 1000
    assert max(loss.lost_s for loss in losses) <= MAX_LOST_S
