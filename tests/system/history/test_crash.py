"""The daemon's history is killed while it writes, again and again: `make bench-history` does so 200 times."""

import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from support.history_crash import Loss, kill_once

KILLS, FILES = 10, 2
LAST_S = 2.5


def test_a_killed_daemon_loses_no_batch_that_was_written_and_never_the_file(tmp_path: Path) -> None:
    """``kill_once`` raises where it does; how many seconds it loses is measured by ``make bench-history``.

    Each file is killed once in each fifth of the time in which batches are begun, written and continued.
    """
    draw, each_s = random.Random(7), LAST_S * FILES / KILLS
    after_s = [[(part + draw.random()) * each_s for part in range(KILLS // FILES)] for _ in range(FILES)]

    def killed(file: int) -> list[Loss]:
        return [kill_once(tmp_path / f"{file}.db", number, s) for number, s in enumerate(after_s[file])]

    with ThreadPoolExecutor(FILES) as each:
        losses = [loss for of_file in each.map(killed, range(FILES)) for loss in of_file]
    assert len(losses) == KILLS
    assert sum(loss.published for loss in losses) > 250
    assert sum(loss.batches > 1 for loss in losses) >= 5
