"""One run: undisturbed exposures, disturbed ones, undisturbed ones, through the daemon and onto its wires."""

from __future__ import annotations

import asyncio
import math
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from altd.devices.aravis.device_clock import DeviceClock
from altd.records import FloatArray, Frame
from benchmarks.campaign.clips import SimulatedClip, SimulatedRig
from benchmarks.campaign.detectability import Subject
from benchmarks.campaign.scene import Scene
from benchmarks.campaign.timed import START_NS
from benchmarks.campaign.way import CAMERAS, Draw, Shot, Spoil, both, spoil_pixels
from benchmarks.campaign.ways.times import MS, PERIOD_NS, Delivery, Mistimed
from benchmarks.faults.catalogue import Fault, is_drawn
from benchmarks.faults.live import live_unit
from benchmarks.faults.wires import Published, TelegramLine, wires_of
from benchmarks.interfaces import Interfaces
from hw_sim.beam import BeamPose
from hw_sim.measure import random_poses

WINDOW = 20
"""The default of ``[measuring] window``."""
BEFORE, BACK = 26, 80
"""Exposures before the onset, and within which the unit must be back."""
_STEADY_S = 0.5
_SHORTEST, _LONGEST = 20, 60
"""Exposures of a fault that does not end by itself."""
_TRANSFER_NS = 5 * MS
_READ_AFTER_NS = 25 * MS
SIGMAS = 5.0
LIMITS = np.array([0.15, 0.15, 0.03, 0.03])
"""Mm, mm, °, °."""
MAX_REASON_S, MAX_BACK_S = 1.0, 3.0
_MAX_AGE_S = 1.0 + WINDOW * PERIOD_NS * 1e-9 / 2
"""The default of ``stale_after_s``, from the window's last exposure."""
_START = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
POLLED = ("http", "local", "modbus")
"""Wires that are asked at each exposure: they time reason and recovery."""




@dataclass(slots=True)
class Result:
    """What one run showed. Errors are the largest of values that were shown, in mm, ° and sigmas."""

    judged: Counter[str] = field(default_factory=Counter)
    """By wire."""
    valid: int = 0
    beyond_sigmas: int = 0
    beyond_limits: int = 0
    stale: int = 0
    no_reason: int = 0
    contradicting: int = 0
    worst_mm: float = 0.0
    worst_deg: float = 0.0
    worst_sigmas: float = 0.0
    reason_s: float | None = None
    """From the onset until every polled wire was invalid with a reason; None: that never was."""
    back_s: float = math.inf
    """From the end until every polled wire was valid."""
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def wrong(self) -> int:
        """Values that no reader may be shown."""
        return self.beyond_limits + self.stale + self.contradicting


@dataclass(frozen=True, slots=True)
class Drawn:
    """A run's faults with their parameters: at most what the three kinds of them need."""

    names: tuple[str, ...]
    note: str
    spoil: Spoil
    times: tuple[Mistimed, ...]
    acts: tuple[Fault, ...]
    is_moving: bool
    is_blind: bool
    undetectable: str


def drawn(faults: Sequence[Fault], rig: SimulatedRig, rng: np.random.Generator) -> Drawn:
    """Draw the parameters of one fault, or of two at once."""
    spoil, times, notes, hidden = Spoil(""), [], [], ""
    for fault in faults:
        if fault.way is None:
            continue
        made = is_drawn(fault.way.make(Draw(rng)))
        notes.append(made.note)
        hidden = hidden or fault.way.invisible
        if isinstance(made, Mistimed):
            times.append(made)
        else:
            spoil = made if not spoil.note else both(spoil, made)
            hidden = hidden or made.undetectable(Subject.of(rig.spec))
    ways = [fault.way for fault in faults if fault.way is not None]
    moving = bool(times) or any(way.moving for way in ways) or rng.random() < 0.2
    return Drawn(
        tuple(fault.name for fault in faults),
        "; ".join(notes),
        spoil,
        tuple(times),
        tuple(fault for fault in faults if fault.act is not None),
        moving,
        any(fault.is_blind for fault in faults),
        hidden,
    )


class _Film:
    """The frames of one run, and when they arrive; the beam's truth."""

    def __init__(self, rig: SimulatedRig, faults: Drawn, rng: np.random.Generator) -> None:
        self._rng = rng
        self.bits = rig.bits
        self._clocks = {camera: DeviceClock() for camera in CAMERAS}
        self._own_clock = any(one.own_clock for one in faults.times)
        self.faults = faults
        own_end_ns = [one.end_ns for one in faults.times if one.end_ns is not None]
        lasts = math.ceil(max(own_end_ns) / PERIOD_NS) if own_end_ns else 0
        if not own_end_ns or len(faults.names) > 1:
            lasts = max(lasts, int(rng.integers(_SHORTEST, _LONGEST + 1)))
        self.end = BEFORE + max(lasts, 1)
        self.length = self.end + BACK + 40
        self.clip = self._clip(rig)
        self.truth = np.array([self.clip.truth(k) for k in range(self.length)])
        self.onset_ns = START_NS + BEFORE * PERIOD_NS
        shots, deliveries = self._shots(), self._deliveries(range(self.end))
        for one in faults.times:
            deliveries = one.change(deliveries, self.onset_ns)
        self.pixels = {(shot.camera, shot.k): shot.pixels for shot in shots}
        last_ns = max((one.arrives_ns for one in deliveries), default=0)
        self.end_ns = max(START_NS + self.end * PERIOD_NS, last_ns - _TRANSFER_NS)
        self.arrivals = sorted(
            [*deliveries, *self._deliveries(range(self.end, self.length))], key=lambda one: one.arrives_ns
        )
        self.held_ns = max((one.held_ns for one in faults.times), default=0)

    def _clip(self, rig: SimulatedRig) -> SimulatedClip:
        rng = self._rng
        if not self.faults.is_moving and not rig.spec.drives:
            (pose,) = random_poses(1, rig.spec.config.target_distance_mm, rng)
            return SimulatedClip(rig, pose, np.zeros(4), 0, self.length, rng)
        x, y = rng.uniform(-15, 15, 2)
        speed = rng.uniform(-1, 1, 4) * (4.0, 4.0, 0.006, 0.006) * min(1.0, 100 / self.length)
        return SimulatedClip(rig, BeamPose(float(x), float(y)), speed, 0, self.length, rng)

    def _shots(self) -> list[Shot]:
        """The frames up to the end of the fault, disturbed."""
        spoil, shots = self.faults.spoil, list[Shot]()
        lit: dict[str, Scene] = {}
        for k in range(self.end):
            for camera in CAMERAS:
                scene = self.clip.scene(camera, k)
                if spoil.light is not None and k >= BEFORE and camera in spoil.cameras:
                    if camera not in lit or not self.clip.still or spoil.varies:
                        lit[camera] = spoil.light(scene, k - BEFORE)
                    scene = lit[camera]
                shots.append(Shot(camera, k, k, 0, self.clip.snap(scene, k, self._rng), self.bits))
        spoil_pixels(spoil, shots, BEFORE)
        return shots if spoil.stream is None else spoil.stream(shots, BEFORE)

    @staticmethod
    def _deliveries(exposures: range) -> list[Delivery]:
        return [
            Delivery(camera, t_ns, 100_000 + k, t_ns, t_ns + _TRANSFER_NS)
            for k in exposures
            for camera in CAMERAS
            for t_ns in (START_NS + k * PERIOD_NS,)
        ]

    def frame(self, one: Delivery) -> Frame | None:
        """A frame as its driver hands it over; None: the driver gives it no time."""
        k = (one.true_ns - START_NS) // PERIOD_NS
        pixels = self.pixels.get((one.camera, k))
        if pixels is None:
            pixels = self.clip.snap(self.clip.scene(one.camera, k), k, self._rng)
        pixels.flags.writeable = False
        t_ns = self._clocks[one.camera].host_ns(one.t_ns, one.arrives_ns) if self._own_clock else one.t_ns
        return None if t_ns is None else Frame(one.camera, one.sequence, t_ns, pixels, self.bits)


def run_episode(
    rig: SimulatedRig, faults: Drawn, rng: np.random.Generator, places: Interfaces, has_broker: bool
) -> Result:
    """Run a daemon through the faults and judge all that its interfaces show."""
    film = _Film(rig, faults, rng)
    with tempfile.TemporaryDirectory(prefix="altd-faults-") as folder:
        return asyncio.run(_run(rig, film, rng, places, Path(folder), has_broker))


async def _run(
    rig: SimulatedRig,
    film: _Film,
    rng: np.random.Generator,
    places: Interfaces,
    folder: Path,
    has_broker: bool,
) -> Result:
    pair_by = film.faults.times[0].pair_by if film.faults.times else "time"
    telegram = TelegramLine(folder / "ttyUSB0")
    judge = _Judge(film)
    async with (
        live_unit(rig, places, folder, telegram.device, START_NS, pair_by) as unit,
        wires_of(places, telegram, unit.socket, has_broker) as wires,
    ):
        waiting = list(reversed(film.arrivals))
        acts = [fault.act(unit, wires, Draw(rng)) for fault in film.faults.acts if fault.act]
        for k in range(film.length):
            now_ns = START_NS + k * PERIOD_NS + _READ_AFTER_NS
            since_ns = now_ns - film.onset_ns
            if 0 < since_ns < film.held_ns:
                continue
            is_held = film.held_ns > 0 and 0 <= since_ns - film.held_ns < PERIOD_NS
            while waiting and waiting[-1].arrives_ns <= now_ns:
                one = waiting.pop()
                await unit.clock.set(one.arrives_ns, at_one_blow=is_held)
                await unit.settle()
                if (frame := film.frame(one)) is not None:
                    await unit.deliver(frame)
            await unit.clock.set(now_ns, at_one_blow=is_held)
            await unit.settle()
            if now_ns >= film.end_ns:
                for act in acts:
                    await act.aclose()
                acts = []
            elif now_ns >= film.onset_ns:
                for act in acts:
                    await anext(act)
            shown = await wires.read()
            judge.take(shown, now_ns, _START + unit.clock.utc_step)
            if judge.is_over(now_ns):
                break
    telegram.close()
    return judge.result


class _Judge:
    """Compares what is shown with the truth."""

    def __init__(self, film: _Film) -> None:
        self.result = Result()
        self._film = film
        self._times_ns = START_NS + PERIOD_NS * np.arange(film.length)
        self._valid_ns: dict[str, int] = {}
        self._invalid: set[str] = set()
        self._back_ns: int | None = None
        self._path = _window_means(film.truth) if film.faults.times else film.truth

    def is_over(self, now_ns: int) -> bool:
        """Whether the unit has been back for a while, or should be."""
        back_ns = self._back_ns
        return back_ns is not None and now_ns - back_ns > _STEADY_S * 1e9 or (
            now_ns - self._film.end_ns > BACK * PERIOD_NS
        )

    def take(self, shown: Sequence[Published], now_ns: int, utc_zero: datetime) -> None:
        """Judge what all wires show at an instant; ``utc_zero`` is the clock's UTC at 0."""
        film, result = self._film, self.result
        for one in shown:
            result.judged[one.wire] += 1
            result.contradicting += one.contradicts
            if one.values is None:
                result.no_reason += not one.reasons
            else:
                self._judge(one, now_ns, utc_zero)
        polled = {one.wire: one for one in shown if one.wire in POLLED}
        is_disturbed = film.onset_ns <= now_ns < film.end_ns
        invalid = [wire for wire, one in polled.items() if one.values is None and one.reasons]
        if now_ns >= film.onset_ns:
            for one in polled.values():
                if one.values is None:
                    result.reasons.update(one.reasons)
        if result.reason_s is None and film.onset_ns <= now_ns and len(invalid) == len(POLLED):
            if is_disturbed or now_ns - film.end_ns < 1e9:
                result.reason_s = (now_ns - film.onset_ns) * 1e-9
        if now_ns >= film.end_ns and self._back_ns is None and not invalid:
            self._back_ns = now_ns
            result.back_s = (now_ns - film.end_ns) * 1e-9
        elif self._back_ns is not None and invalid:
            self._back_ns = None

    def _judge(self, one: Published, now_ns: int, utc_zero: datetime) -> None:
        assert one.values is not None  # noqa: S101  asked before
        assert one.sigma is not None  # noqa: S101  they come together
        film, result = self._film, self.result
        result.valid += 1
        if one.age_s is not None:
            t_ns = now_ns - one.age_s * 1e9
        elif one.utc is None:
            result.contradicting += 1
            return
        else:  # a clock that was set: what was made before has the time of then
            labels = (one.utc - utc_zero, one.utc - _START)
            t_ns = min((label.total_seconds() * 1e9 for label in labels), key=lambda t: abs(t - now_ns))
        result.stale += now_ns - t_ns > _MAX_AGE_S * 1e9 + PERIOD_NS
        if film.faults.spoil.no_beam and film.onset_ns <= t_ns + PERIOD_NS / 2 < film.end_ns:
            error = np.full(4, np.inf)
        elif film.faults.times:
            error = self._best(one, now_ns)
        else:
            at_ns = t_ns + PERIOD_NS * (np.arange(one.frames) - (one.frames - 1) / 2)
            places = [np.interp(at_ns, self._times_ns, column).mean() for column in film.truth.T]
            error = np.abs(one.values - places)
        sigmas = float((error / one.sigma).max())
        result.beyond_sigmas += not sigmas <= SIGMAS
        result.beyond_limits += bool(np.any(~(error <= LIMITS)))
        result.worst_mm = max(result.worst_mm, float(error[:2].max()))
        result.worst_deg = max(result.worst_deg, float(error[2:].max()))
        result.worst_sigmas = max(result.worst_sigmas, sigmas)

    def _best(self, one: Published, now_ns: int) -> FloatArray:
        """The error against where the beam was at the best time of those that a reader may be shown."""
        assert one.values is not None  # noqa: S101  asked before
        at_ns = np.linspace(now_ns - _MAX_AGE_S * 1e9, now_ns, 240)
        places = np.stack([np.interp(at_ns, self._times_ns, column) for column in self._path.T], axis=1)
        errors = np.abs(places - one.values)
        best: FloatArray = errors[(errors / LIMITS).max(axis=1).argmin()]
        return best


def _window_means(truth: FloatArray) -> FloatArray:
    """The path of the window's mean about each exposure: without the vibration, as far as it averages."""
    padded = np.pad(truth, ((WINDOW // 2, WINDOW - WINDOW // 2 - 1), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros(truth.shape[1]), padded]), axis=0)
    return np.asarray((sums[WINDOW:] - sums[:-WINDOW]) / WINDOW)
