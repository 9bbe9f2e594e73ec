"""``python -m benchmarks.self_check_cost`` (``make bench-selfcheck``): cost of a self-check.

The real daemon runs on cameras in memory that show the frame LEDs in their switched state, 20 exposures a
second. A Modbus TCP client polls it 50 times a second, and further processes load the CPU.
"""

import asyncio
import contextlib
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from altd.acquisition.self_check.schedule import REST_S
from altd.app.daemon import Daemon
from altd.reasons import Reason
from altd.records import Frame
from benchmarks.daemon import SETTLE_S, running
from benchmarks.harness import Columns, Parser, child, end, reporter
from benchmarks.material import FPS, SEED, Material, Source, exposed, make_config, stamped
from benchmarks.selfcheck_units import calibrated
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose
from hw_sim.ports import free_port


class LedLine:
    """LED line, see ``altd.ports.Lamps``; it records its switching times."""

    def __init__(self) -> None:
        self._switched: list[tuple[int, bool]] = [(0, False)]

    def forget(self) -> None:
        """Switch off, and discard the recorded times."""
        self._switched = [(0, False)]

    def open(self) -> None:
        """Switch off."""
        self.switch(False)

    def switch(self, on: bool) -> None:
        """Switch the LEDs from now on."""
        if on is not self._switched[-1][1]:
            self._switched.append((time.monotonic_ns(), on))

    def close(self) -> None:
        """Switch off."""
        self.switch(False)

    def level_at(self, t_ns: int) -> bool:
        """Whether the LEDs were on at a time."""
        return next(on for since_ns, on in reversed(self._switched) if since_ns <= t_ns)

    @property
    def lit_s(self) -> list[float]:
        """Durations of the periods with the LEDs on."""
        edges = self._switched[1:]
        return [
            (off_ns - on_ns) * 1e-9 for (on_ns, _), (off_ns, _) in zip(edges[::2], edges[1::2], strict=False)
        ]


@dataclass(frozen=True, slots=True)
class LedMaterial(Material):
    """Pairs of a beam at rest with the LEDs off and, in the same number, ``lit_pairs``."""

    lit_pairs: tuple[tuple[Frame, Frame], ...]
    line: LedLine

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        """Frame set number ``sequence`` of an endless run, exposed at ``t_ns``, from the repeated pairs.

        Each repetition is a separate playthrough, because its pictures repeat intentionally.
        """
        turn, number = divmod(sequence, len(self.pairs))
        pairs = self.lit_pairs if self.line.level_at(t_ns) else self.pairs
        return stamped(pairs[number], sequence, t_ns, turn)


def make_led_material(pairs: int) -> tuple[LedMaterial, LedLine]:
    """Render the pairs and calibrate their unit from its own scan."""
    unit, line, calibration = simulated.Unit(simulated.UnitConfig(seed=SEED)), LedLine(), calibrated(SEED)
    unit.place(BeamPose(4.0, -3.0, 0.02, -0.03))

    def render(on: bool, first: int) -> tuple[tuple[Frame, Frame], ...]:
        unit.leds_on = on
        made = exposed(unit, range(first, first + pairs))
        return tuple((replace(front, leds_on=False), replace(rear, leds_on=False)) for front, rear in made)

    dark, lit = render(False, 0), render(True, pairs)
    return LedMaterial(dark, calibration, calibration, lit, line), line


POLLS_PER_S = 50.0
BUSY_PROCESSES = 0, 1, 2, 4
_PAIRS = 40
_AFTER_S = 2.0
"""Time after its answer in which a check counts as the cause of changes; a window is filled by then."""
_WITHIN_S = 30.0


@dataclass(frozen=True, slots=True)
class Polls:
    """Polls of the client in a part of the time; ``reasons`` of the invalid polls."""

    count: int
    invalid: int
    largest_age_ms: int
    longest_gap_s: float
    """Longest time between two new measurements, in the daemon."""
    reasons: Counter[str]


@dataclass(frozen=True, slots=True)
class CheckCost:
    """Cost by check. ``checking``: polls from request to ``_AFTER_S`` after the answer, ``between``: rest."""

    verdicts: Counter[str]
    lost: list[int]
    lit_s: list[float]
    answer_s: list[float]
    checking: Polls
    between: Polls


@dataclass(frozen=True, slots=True)
class _Poll:
    sent_s: float
    header: list[int]

    @property
    def is_valid(self) -> bool:
        return bool(self.header[0] & 1)

    @property
    def age_ms(self) -> int:
        return self.header[6]

    @property
    def reasons(self) -> str:
        codes = [code for code in self.header[2:5] if code]
        return ", ".join(sorted({str(reason) for reason in Reason if reason.modbus_code in codes}))


def measure_checks(material: Material, line: LedLine, checks: int, busy: int) -> CheckCost:
    """Request checks one after another, beside ``busy`` processes that load the CPU."""
    return asyncio.run(_measured(material, line, checks, busy))


async def _measured(material: Material, line: LedLine, checks: int, busy: int) -> CheckCost:
    port = free_port()
    line.forget()
    async with running(
        Source(material, FPS), make_config(modbus_tcp={"host": "127.0.0.1", "port": port}), line
    ) as daemon:
        service = daemon.health.self_check
        async with asyncio.timeout(_WITHIN_S):
            await service.report(1)
        published_s: list[float] = []
        watching = asyncio.create_task(_watch(daemon, published_s))
        spans, verdicts, lost, answer_s = [], Counter[str](), [], []
        try:
            with _busy(busy), reporter("benchmarks.poller", port, "--rate", POLLS_PER_S) as poller:
                await asyncio.sleep(SETTLE_S)
                first_s, before = time.monotonic(), len(line.lit_s)
                for _ in range(checks):
                    await asyncio.sleep(REST_S)
                    begun_s = time.monotonic()
                    async with asyncio.timeout(_WITHIN_S):
                        document = (await service.report(service.ask())).document
                    answer_s.append(time.monotonic() - begun_s)
                    await asyncio.sleep(_AFTER_S)
                    spans.append((begun_s, time.monotonic()))
                    verdicts[str(document["verdict"])] += 1
                    lost.append(int(str(document["exposures_lost"])))
                last_s = time.monotonic()
                printed = json.loads(await asyncio.to_thread(poller.result))["polls"]
                polls = [_Poll(sent_s, header) for sent_s, _, *header in printed]
        finally:
            watching.cancel()
        rests = list(
            zip([first_s, *(end for _, end in spans)], [begin for begin, _ in spans] + [last_s], strict=True)
        )
        return CheckCost(
            verdicts,
            lost,
            line.lit_s[before:],
            answer_s,
            _told(polls, published_s, spans),
            _told(polls, published_s, rests),
        )


def _told(polls: list[_Poll], published_s: list[float], spans: list[tuple[float, float]]) -> Polls:
    def falls(at_s: float) -> bool:
        return any(begin <= at_s < end for begin, end in spans)

    here = [poll for poll in polls if falls(poll.sent_s)]
    invalid = [poll for poll in here if not poll.is_valid]
    return Polls(
        len(here),
        len(invalid),
        max(poll.age_ms for poll in here),
        max(after - before for before, after in pairwise(published_s) if falls(before)),
        Counter(poll.reasons for poll in invalid),
    )


async def _watch(daemon: Daemon, published_s: list[float]) -> None:
    cursor = daemon.board.cursor()
    while True:
        await cursor.next()
        published_s.append(time.monotonic())


@contextlib.contextmanager
def _busy(count: int) -> Iterator[None]:
    """Run processes that load the CPU."""
    with contextlib.ExitStack() as processes:
        for _ in range(count):
            processes.enter_context(child([sys.executable, "-c", "while True: pass"]))
        yield


_CHECKS = Columns(
    "busy:>6", "verdicts:>20", "lost:>9", "lit, s:>9.3f", "answer, s:>11.2f", "   largest of each:"
)
_POLLS = Columns(":6", "polls:>20", "gap, s:>9.2f", "age, ms:>9", "polls:>9", "invalid:>9", "  why:")


def _rows(busy: int, cost: CheckCost) -> Iterator[str]:
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(cost.verdicts.items()))
    lost = f"{min(cost.lost)} to {max(cost.lost)}"
    yield _CHECKS.row(busy, verdicts, lost, max(cost.lit_s, default=0.0), max(cost.answer_s))
    for what, told in (("checking", cost.checking), ("between", cost.between)):
        reasons = "; ".join(f"{count} {reason}" for reason, count in told.reasons.most_common())
        figures = told.longest_gap_s, told.largest_age_ms, told.count, told.invalid
        yield _POLLS.row("", what, *figures, f"  {reasons}")


def main(arguments: list[str] | None = None) -> int:
    """Print a table."""
    parser = Parser("benchmarks.self_check_cost", __doc__)
    parser.count("--checks", 5, "beside each number of busy processes")
    checks = parser.parse_args(arguments).checks
    material, line = make_led_material(_PAIRS)
    print(f"{FPS:g} exposures/s, {POLLS_PER_S:g} polls/s")
    print(_CHECKS.head, _POLLS.head, sep="\n")
    for busy in BUSY_PROCESSES:
        print(*_rows(busy, measure_checks(material, line, checks, busy)), sep="\n", flush=True)
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.self_check_cost")
