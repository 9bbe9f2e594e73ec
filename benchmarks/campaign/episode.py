"""One episode: clean exposures, then disturbed ones, through the daemon's own measuring chain.

Frames with wrong times and numbers go through pipeline and board, and a reader of the board is judged.
"""

import asyncio
import heapq
import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import count as numbers_from

import numpy as np

from altd.acquisition.acquiring import StampCheck
from altd.acquisition.frame_pairs import FramePairs
from altd.acquisition.locating import LocatedPairs
from altd.acquisition.pipeline import Pipeline
from altd.config import Measuring
from altd.devices.aravis.device_clock import DeviceClock
from altd.instruments.beam.instrument import QUANTITIES
from altd.measuring.chain import MeasuringChain
from altd.measuring.spot_locator import Located
from altd.ports import Stop
from altd.reasons import Reason
from altd.records import FloatArray, Frame, Measurement, PixelArray
from altd.status.board import Board
from altd.status.health import Health
from benchmarks.campaign.clips import Clip, Rig, SimulatedRig
from benchmarks.campaign.judge import LIMITS, SIGMAS, Judgement, Outcome, Verdict, arrays, judge, truth_of
from benchmarks.campaign.scene import Scene
from benchmarks.campaign.units import chain_of
from benchmarks.campaign.way import CAMERAS, MS, PERIOD_NS, START_NS, Shot, Spoil, spoil_pixels
from benchmarks.campaign.ways.numbers import Misnumbered, accepted
from benchmarks.campaign.ways.times import Delivery, Mistimed, undisturbed

WINDOW = 6
_WARMING_UP = (str(Reason.WARMING_UP),)

SPOILT = 9
_SAME_TIME_NS = 5_000_000
"""Tolerance of a measurement's time after the beam has ended; the window then holds only earlier
exposures."""


def run_episode(
    rig: Rig, spoil: Spoil, rng: np.random.Generator, moving: bool, foreign: Rig | None = None
) -> Outcome:
    """Measure a clip of a unit, disturbed from the onset on; ``foreign``: with that unit's frames then."""
    onset = WINDOW if rng.random() < 0.8 else 0
    clip = rig.clip(rng, WINDOW + SPOILT, moving)
    if clip.length < WINDOW + SPOILT:
        onset = 0
    shots = shots_of(clip, spoil, rng, onset, rig.bits, clip.length)
    if foreign is not None:
        other_clip = foreign.clip(rng, clip.length, moving)
        others = shots_of(other_clip, spoil, rng, onset, foreign.bits, other_clip.length)
        shots = [other if shot.k >= onset else shot for shot, other in zip(shots, others, strict=True)]
    if spoil.stream is not None:
        shots = spoil.stream(shots, onset)
    measured = _measured(chain_of(rig.calibration, Measuring(window=WINDOW, every=1)), shots)
    truth = [clip.truth(k) for k in range(clip.length)]
    judged = [
        (k, judge(one, _truth_of(one, truth, k, onset if spoil.no_beam else None))) for k, one in measured
    ]
    judged = [(k, one) for k, one in judged if one.reasons != _WARMING_UP]
    return Outcome(
        tuple(one for k, one in judged if WINDOW - 1 <= k < onset),
        tuple(one for k, one in judged if k >= onset),
    )


def run_misnumbered(rig: Rig, way: Misnumbered, rng: np.random.Generator) -> Outcome:
    """Measure with files that contain an invalid number; a refusal of the files counts as invalid."""
    taken = accepted(way, rig.calibration)
    if taken is None:
        return Outcome((), (Judgement(Verdict.INVALID, reasons=("refused",)),))
    calibration, measuring, installation = taken
    measuring = measuring.model_copy(update={"window": WINDOW})
    clip = rig.clip(rng, WINDOW, False)
    chain = chain_of(calibration, measuring, installation)
    measured = _measured(chain, shots_of(clip, Spoil(way.note), rng, 0, rig.bits, clip.length))
    judged = [judge(one, None if way.is_none else clip.truth(k)) for k, one in measured]
    return Outcome((), tuple(one for one in judged if one.reasons != _WARMING_UP))


def shots_of(
    clip: Clip, spoil: Spoil, rng: np.random.Generator, onset: int, bits: int, length: int
) -> list[Shot]:
    """The first frames of a clip, their light and grey values disturbed from the onset on."""
    shots = []
    kept: dict[str, Scene] = {}
    for k in range(length):
        for camera in CAMERAS:
            scene = clip.scene(camera, k)
            if spoil.light is not None and k >= onset and camera in spoil.cameras:
                if camera not in kept or not clip.still or spoil.varies:
                    kept[camera] = spoil.light(scene, k - onset)
                scene = kept[camera]
            t_ns = START_NS + k * PERIOD_NS
            shots.append(Shot(camera, k, k + 1000, t_ns, clip.snap(scene, k, rng), bits))
    spoil_pixels(spoil, shots, onset)
    return shots


def _measured(chain: MeasuringChain, shots: Sequence[Shot]) -> list[tuple[int, Measurement]]:
    """Each measurement with the number of the frame set that completed it."""
    measured = []
    for shot in shots:
        shot.pixels.flags.writeable = False
        frame = Frame(shot.camera, shot.sequence, shot.t_ns, shot.pixels, shot.bits, exposure_ms=1.0)
        measured += [(shot.k, measurement) for measurement in chain.push(frame)]
    return measured


def _truth_of(
    measurement: Measurement, truth: Sequence[FloatArray], k: int, ended: int | None = None
) -> FloatArray | None:
    """Mean position of the beam in the window that ends with frame set ``k``.

    If the beam ``ended`` at a frame set, only earlier exposures may be averaged: None if the measurement's
    time contradicts that.
    """
    window = range(max(k - WINDOW + 1, 0), k + 1 if ended is None else min(k + 1, ended))
    times_ns = START_NS + PERIOD_NS * np.array(window, dtype=np.float64)
    has_ended = ended is not None and k >= ended
    if has_ended and (not len(window) or abs(measurement.t_ns - times_ns.mean()) > _SAME_TIME_NS):
        return None
    return truth_of(measurement, np.array([truth[n] for n in window]), times_ns)


START_UTC = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
_TURNS = 6
"""Turns of the event loop in which every woken task reaches its next wait."""


class SteppedClock:
    """An ``altd.ports.Clock`` whose time advances only when it is set."""

    def __init__(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._number = numbers_from()

    def monotonic_ns(self) -> int:
        """Time that was set."""
        return self._now_ns

    def utc(self, t_ns: int) -> datetime:
        """UTC of a monotonic instant."""
        return START_UTC + timedelta(microseconds=t_ns / 1000)

    async def sleep(self, seconds: float) -> None:
        """Wait until the time has been set that far."""
        future = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self._now_ns + round(seconds * 1e9), next(self._number), future))
        await future

    def wait(self, stop: Stop, seconds: float) -> None:
        """Raise NotImplementedError: no thread of the campaign waits."""
        raise NotImplementedError

    async def pass_to(self, t_ns: int, *, at_one_blow: bool = False) -> None:
        """Advance the time; sleepers wake at their instants, or all at the end if the process was held."""
        await self.settle()
        while self._sleepers and (due_ns := self._sleepers[0][0]) <= t_ns:
            self._now_ns = t_ns if at_one_blow else max(due_ns, self._now_ns)
            while self._sleepers and self._sleepers[0][0] == due_ns:
                future = heapq.heappop(self._sleepers)[2]
                if not future.done():
                    future.set_result(None)
            await self.settle()
        self._now_ns = max(t_ns, self._now_ns)

    async def settle(self) -> None:
        """Let every task run until it waits."""
        for _ in range(_TURNS):
            await asyncio.sleep(0)


_BEFORE, _AFTER = 20, 60
"""Exposures before the onset, and after the end of the disturbance."""
_TIMED_WINDOW = 8
_MAX_AGE_NS = 1_000 * MS + _TIMED_WINDOW * PERIOD_NS
"""Maximum age of a displayed measurement: the default of ``stale_after_s``, and the length of a window."""


def run_timed(rig: Rig, way: Mistimed, rng: np.random.Generator) -> Outcome:
    """Simulate a driving machine, disturb its frames' times, and judge the board every 50 ms."""
    if not isinstance(rig, SimulatedRig):
        raise TypeError("only a simulated unit drives")
    onset_ns = START_NS + _BEFORE * PERIOD_NS
    end_ns = onset_ns + (0 if way.end_ns is None else way.end_ns)
    count = math.ceil((end_ns - START_NS) / PERIOD_NS) + _AFTER
    clip = rig.driving_clip(rng, count)
    arrivals = sorted(way.change(undisturbed(range(count)), onset_ns), key=lambda one: one.arrives_ns)
    shots = {
        (camera, k): clip.snap(clip.scene(camera, k), k, rng) for k in range(count) for camera in CAMERAS
    }
    read = asyncio.run(_read(rig, way, arrivals, shots, onset_ns, START_NS + count * PERIOD_NS))
    truth = _without_vibration(np.array([clip.truth(k) for k in range(count)]))
    judged = [(now_ns, _judged(one, truth, now_ns)) for now_ns, one in read if one is not None]
    shown = [(now_ns, one) for now_ns, one in judged if one.reasons != _WARMING_UP]
    recovered_s = None
    if way.end_ns is not None:
        valid = [now_ns for now_ns, one in shown if now_ns >= end_ns and one.verdict is not Verdict.INVALID]
        recovered_s = (valid[0] - end_ns) * 1e-9 if valid else math.inf
    return Outcome(
        tuple(one for now_ns, one in shown if now_ns < onset_ns),
        tuple(one for now_ns, one in shown if now_ns >= onset_ns),
        recovered_s,
    )


async def _read(
    rig: SimulatedRig,
    way: Mistimed,
    arrivals: Sequence[Delivery],
    shots: dict[tuple[str, int], PixelArray],
    onset_ns: int,
    end_ns: int,
) -> list[tuple[int, Measurement | None]]:
    """Read the board every 50 ms."""
    clock = SteppedClock(START_NS)
    measuring = Measuring(window=_TIMED_WINDOW, pair_by=way.pair_by)
    board = Board(clock, Measuring().stale_after_s, QUANTITIES, rehearsal=True)  # frames are simulated
    chain = chain_of(rig.calibration, measuring)
    component = Health(clock).component("measuring")
    pairs = FramePairs(chain.pairer, lambda: None, clock)
    located: LocatedPairs[Located] = LocatedPairs(pairs)
    pipeline = Pipeline(located, chain, board, component)
    task = asyncio.create_task(pipeline.run())
    found: list[tuple[int, Measurement | None]] = []
    waiting = list(arrivals)
    stamps = {camera: StampCheck() for camera in CAMERAS}  # as in the cameras' threads
    clocks = {camera: DeviceClock() for camera in CAMERAS}
    for now_ns in range(START_NS, end_ns, PERIOD_NS // 2):
        if 0 < now_ns - onset_ns < way.held_ns:
            continue
        was_held = way.held_ns > 0 and 0 <= now_ns - onset_ns - way.held_ns < PERIOD_NS // 2
        while waiting and waiting[0].arrives_ns <= now_ns:
            one = waiting.pop(0)
            await clock.pass_to(one.arrives_ns, at_one_blow=was_held)
            pixels = shots[one.camera, (one.true_ns - START_NS) // PERIOD_NS]
            t_ns = clocks[one.camera].host_ns(one.t_ns, one.arrives_ns) if way.own_clock else one.t_ns
            if t_ns is None:
                continue
            frame = Frame(one.camera, one.sequence, t_ns, pixels, rig.bits, exposure_ms=1.0)
            if not stamps[one.camera].refusal(frame, clock.monotonic_ns()):
                pairs.put(frame, wait=False)
            for pair in pairs.take():
                located.put(pair.converted(chain.located))
            await clock.settle()
        await clock.pass_to(now_ns, at_one_blow=was_held)
        await clock.settle()
        found.append((now_ns, board.read()))
        if task.done():
            task.result()
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return found


def _without_vibration(places: FloatArray) -> FloatArray:
    """The path, (exposures, 4), without the vibration about it."""
    k = np.arange(len(places))
    return np.stack([np.polyval(np.polyfit(k, column, 2), k) for column in places.T], axis=1)


def _judged(measurement: Measurement, truth: FloatArray, now_ns: int) -> Judgement:
    """Judge against the machine's position at the best-fitting time among those that may be displayed."""
    if not measurement.valid:
        return judge(measurement, None)
    values, sigma = arrays(measurement)
    oldest, newest = (int((t_ns - START_NS) // PERIOD_NS) for t_ns in (now_ns - _MAX_AGE_NS, now_ns))
    fine = np.linspace(max(oldest, 0), min(newest, len(truth) - 1), 8 * (newest - max(oldest, 0)) + 1)
    places = np.stack([np.interp(fine, np.arange(len(truth)), column) for column in truth.T], axis=1)
    errors = np.abs(places - values)
    penalty = np.minimum(errors / (SIGMAS * sigma), errors / LIMITS).max(axis=1)
    return judge(measurement, places[int(penalty.argmin())])
