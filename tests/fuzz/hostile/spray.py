"""``python -m fuzz.hostile.spray`` (``make bench-spray``): the daemon under datagrams from forged sources.

To be run in a network namespace of its own: ``unshare -rn``. Ends with status 1 when the daemon died, or a
valid measurement was wrong: further than 5 of its sigmas, and 0.05 mm or 0.01 degrees, from the truth.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fuzz.hostile.datagrams import FOREIGN, PHASES

from benchmarks.harness import KEYS, child
from benchmarks.live.parts import FRONT, REAR, SEED, both_cameras, calibrate, ip, measuring_daemon
from benchmarks.live.watch import Received
from benchmarks.process_memory import resident_mb
from hw_sim.gige.command import make_unit
from hw_sim.unit import Unit

TESTS = Path(__file__).parents[2]
WRONG_SIGMAS = 5.0
MIN_WRONG_ERRORS = {"x_mm": 0.05, "y_mm": 0.05, "yaw_deg": 0.01, "pitch_deg": 0.01}
_VALID_TIMEOUT_S = 30.0
_RSS_INTERVAL_S = 5.0
_PHASE_S = 4.0
_SETTLE_S = 0.5


@dataclass(slots=True)
class Phase:
    """One way to attack, all its turns together, each without its first half second."""

    seconds: float = 0.0
    sent: int = 0
    measurements: int = 0
    valid: int = 0


@dataclass(frozen=True, slots=True)
class SprayResult:
    """The state of a daemon under attack. ``rss_mb`` are resident sizes, one in five seconds."""

    seconds: float
    measurements: int
    valid: int
    wrong: list[str]
    reasons: Counter[str]
    rss_mb: list[float]
    valid_again_after_s: float
    phases: dict[str, Phase]


def main(arguments: Sequence[str] | None = None) -> int:
    """Attack, print the result."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.hostile.spray", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long (600)")
    parser.add_argument("--rate", type=float, default=4000.0, help="datagrams a second (4000)")
    parser.add_argument("--seed", type=int, default=1, help="of the datagrams (1)")
    options = parser.parse_args(arguments)
    ip("link", "set", "lo", "up")
    ip("address", "add", f"{REAR}/32", "dev", "lo")
    with tempfile.TemporaryDirectory(prefix="altd-spray-") as name:
        folder = Path(name)
        sprayed = spray(folder, calibrate(SEED, folder), options.seconds, options.rate, options.seed)
    print("\n".join(_lines(sprayed)))
    return 1 if sprayed.wrong else 0


def spray(folder: Path, calibration: Path, seconds: float, rate: float, seed: int) -> SprayResult:
    """Attack a daemon with two cameras; raises RuntimeError with its log when it does not survive."""
    unit = make_unit(SEED, drive=True)
    with (
        both_cameras(folder, "--drive") as cameras,
        measuring_daemon(folder, calibration, (FRONT, REAR)) as (daemon, watch),
    ):
        watch.first(lambda seen: seen.valid, 0.0, _VALID_TIMEOUT_S)
        pids = str(daemon.process.pid), str(cameras.process.pid)
        phase_s = min(_PHASE_S, seconds / len(PHASES))
        how = [str(value) for value in (seconds, phase_s, rate, seed)]
        program = ["env", f"PYTHONPATH={TESTS}", sys.executable, "-m", "fuzz.hostile.datagrams"]
        first, rss_mb = len(watch.seen), []
        with child([*program, *pids, *how], folder / "attacker.log") as attack:
            until_s = time.monotonic() + seconds + _VALID_TIMEOUT_S
            while {attack.process.poll(), daemon.process.poll()} == {None} and time.monotonic() < until_s:
                with suppress(StopIteration):  # it is ending
                    rss_mb.append(resident_mb(daemon.process.pid))
                time.sleep(min(_RSS_INTERVAL_S, seconds / 4))
            output = attack.output.strip()
        if daemon.process.poll() is not None:
            status = daemon.process.returncode
            raise RuntimeError(f"the daemon ended with {status}: {daemon.output[-2000:]}")
        if attack.process.returncode != 0:
            raise RuntimeError(f"the attack ended with {attack.process.returncode}: {output}")
        ended_s = time.monotonic()
        back = watch.first(lambda seen: seen.valid, ended_s, _VALID_TIMEOUT_S)
        seen = watch.seen[first:]
        if watch.failure is not None:
            raise watch.failure
    reasons = Counter(reason for one in seen if not one.valid for reason in one.reasons)
    return SprayResult(
        seconds=seconds,
        measurements=len(seen),
        valid=sum(one.valid for one in seen),
        wrong=[line for one in seen if one.valid for line in _wrong(one, unit)],
        reasons=reasons,
        rss_mb=rss_mb,
        valid_again_after_s=back.arrived_s - ended_s,
        phases=_phases(output, ended_s, seen),
    )


def _phases(log: str, ended_s: float, seen: list[Received]) -> dict[str, Phase]:
    rows = [line.split(maxsplit=2) for line in log.splitlines()]
    began_s = [float(row[0]) for row in rows]
    phases = {name: Phase() for name in PHASES}
    for (_, sent, name), begin_s, to_s in zip(rows, began_s, [*began_s[1:], ended_s], strict=True):
        from_s = begin_s + _SETTLE_S
        inside = [one.valid for one in seen if from_s <= one.arrived_s < to_s]
        phase = phases[name]
        phase.seconds += max(to_s - from_s, 0.0)
        phase.sent += int(sent)
        phase.measurements += len(inside)
        phase.valid += sum(inside)
    return phases


def _wrong(seen: Received, unit: Unit) -> Iterator[str]:
    measurement = seen.measurement
    truth = unit.truth(round(measurement["t_s"] * 1e9), vibration=False)
    for name in KEYS:
        error = measurement[name] - getattr(truth, name)
        if abs(error) > max(WRONG_SIGMAS * measurement["sigma"][name], MIN_WRONG_ERRORS[name]):
            yield f"{measurement['time']} {name} wrong by {error:.4f}, sigma {measurement['sigma'][name]:.4f}"


def _lines(sprayed: SprayResult) -> Iterator[str]:
    yield f"sprayed for {sprayed.seconds:.0f} s from {FOREIGN} and in the cameras' names"
    yield f"{'way':<32}{'s':>7}{'datagrams':>11}{'measurements':>14}{'valid':>7}{'valid/s':>9}"
    for name, phase in sprayed.phases.items():
        yield (
            f"{name:<32}{phase.seconds:>7.1f}{phase.sent:>11}{phase.measurements:>14}{phase.valid:>7}"
            f"{phase.valid / max(phase.seconds, 1e-9):>9.1f}"
        )
    yield (
        f"{sprayed.measurements} measurements, {sprayed.valid} valid, {len(sprayed.wrong)} of their numbers "
        f"wrong; valid again {sprayed.valid_again_after_s:.1f} s after the end"
    )
    reasons = ", ".join(f"{count} {reason}" for reason, count in sprayed.reasons.most_common())
    yield f"invalid: {reasons or 'none'}"
    step = max(1, len(sprayed.rss_mb) // 10)
    rss_mb = ", ".join(f"{value:.0f}" for value in sprayed.rss_mb[::step])
    yield f"resident memory, MB: {rss_mb}; last {sprayed.rss_mb[-1]:.0f}, largest {max(sprayed.rss_mb):.0f}"
    yield from sprayed.wrong[:20]


if __name__ == "__main__":
    sys.exit(main())
