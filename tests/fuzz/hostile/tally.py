"""The result of a run."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

MAX_WRONG = 20
"""Complaints that are kept of an attacker."""


@dataclass
class Tally:
    """``answers`` by what they were; ``wrong`` are answers and readings that break the contract, in words."""

    answers: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    polls: int = 0
    slowest_poll_s: float = 0.0
    pictures: int = 0
    """That a browser was rightly shown meanwhile."""
    seconds: float = 0.0
    memory_mb: tuple[float, float] = 0.0, 0.0
    """Of the process that serves: before, and when all was over."""

    def polled(self, took_s: float) -> None:
        """A poller read the right number."""
        self.polls += 1
        self.slowest_poll_s = max(self.slowest_poll_s, took_s)

    def lines(self) -> Iterator[str]:
        """For a person."""
        total = self.answers.total()
        yield f"{total} inputs in {self.seconds:.1f} s, {total / self.seconds:.0f} a second"
        yield "answers: " + ", ".join(f"{answer} {count}" for answer, count in sorted(self.answers.items()))
        yield f"poller: {self.polls} right readings, the slowest after {1e3 * self.slowest_poll_s:.0f} ms"
        if self.pictures:
            yield f"browser: {self.pictures} right pictures"
        yield "memory: {:.1f} MB before, {:.1f} MB after".format(*self.memory_mb)
        yield f"wrong: {len(self.wrong)}"
        yield from self.wrong[:MAX_WRONG]
