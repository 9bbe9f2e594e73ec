"""One run of undisturbed, disturbed and undisturbed exposures, through the daemon to its interfaces."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from altd.config import Measuring
from altd.devices.aravis.device_clock import DeviceClock
from altd.records import FloatArray, Frame
from benchmarks.campaign.clips import SimulatedClip, SimulatedRig
from benchmarks.campaign.detectability import Subject
from benchmarks.campaign.episode import START_UTC, shots_of
from benchmarks.campaign.way import CAMERAS, MS, PERIOD_NS, START_NS, Draw, Spoil, both
from benchmarks.campaign.ways.times import TRANSFER_NS, Delivery, Mistimed, undisturbed
from benchmarks.faults.catalogue import Act, Fault
from benchmarks.faults.judging import MAX_AGE_S, WINDOW, Judge, Result, error_of_times, exposures_ns
from benchmarks.faults.live import live_unit
from benchmarks.faults.wires import Published, TelegramLine, wires_of
from benchmarks.interfaces import Interfaces
from hw_sim.measure import random_poses

BEFORE, BACK = 22, 80
"""Exposures before the onset, and maximum number of exposures until recovery."""
_STEADY_NS = 250 * MS
_SHORTEST, _LONGEST = 20, 40
"""Minimum and maximum number of exposures of a fault without its own end."""
_READ_AFTER_NS = 25 * MS


@dataclass(frozen=True, slots=True)
class Drawn:
    """Faults of a run with their parameters, by the three kinds."""

    names: tuple[str, ...]
    note: str
    spoil: Spoil
    times: tuple[Mistimed, ...]
    acts: tuple[Act, ...]
    is_moving: bool
    is_blind: bool
    undetectable: str

    def without_effect(self) -> Drawn:
        """The same run with faults that change nothing."""
        times = tuple(replace(one, change=lambda deliveries, _: deliveries, held_ns=0) for one in self.times)
        return replace(self, spoil=Spoil(""), times=times, acts=())


def drawn(faults: Sequence[Fault], rig: SimulatedRig, rng: np.random.Generator) -> Drawn:
    """Draw the parameters of one fault, or of two at once."""
    spoil, times, notes, hidden = Spoil(""), [], [], ""
    for fault in faults:
        if fault.way is None:
            continue
        made = fault.way.make(Draw(rng))
        hidden = hidden or fault.way.invisible
        if isinstance(made, Mistimed):
            times.append(made)
            notes.append(f"{made.note} (by {made.pair_by})")
        elif isinstance(made, Spoil):
            notes.append(made.note)
            spoil = made if not spoil.note else both(spoil, made)
            hidden = hidden or made.undetectable(Subject.of(rig.spec))
    ways = [fault.way for fault in faults if fault.way is not None]
    moving = bool(times) or any(way.moving for way in ways) or rng.random() < 0.2
    return Drawn(
        names=tuple(fault.name for fault in faults),
        note="; ".join(notes),
        spoil=spoil,
        times=tuple(times),
        acts=tuple(fault.act for fault in faults if fault.act is not None),
        is_moving=moving,
        is_blind=spoil.no_beam or any(fault.is_blind for fault in faults),
        undetectable=hidden,
    )


class _Film:
    """Frames of one run with their arrival times, and the beam's truth."""

    def __init__(self, rig: SimulatedRig, faults: Drawn, rng: np.random.Generator) -> None:
        self.rng = rng
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
        if faults.is_moving or rig.spec.drives:
            self.clip = rig.driving_clip(rng, self.length)
        else:
            (pose,) = random_poses(1, rig.spec.config.target_distance_mm, rng)
            self.clip = SimulatedClip(rig, pose, np.zeros(4), 0, self.length, rng)
        self._truth = np.array([self.clip.truth(k) for k in range(self.length)])
        self._path = _window_means(self._truth)
        self.onset_ns = START_NS + BEFORE * PERIOD_NS
        shots = shots_of(self.clip, faults.spoil, rng, BEFORE, self.bits, self.end)
        if faults.spoil.stream is not None:
            shots = faults.spoil.stream(shots, BEFORE)
        deliveries = undisturbed(range(self.end))
        for one in faults.times:
            deliveries = one.change(deliveries, self.onset_ns)
        self.pixels = {(shot.camera, shot.k): shot.pixels for shot in shots}
        last_ns = max((one.arrives_ns for one in deliveries), default=0)
        self.end_ns = max(START_NS + self.end * PERIOD_NS, last_ns - TRANSFER_NS)
        self.arrivals = sorted(
            [*deliveries, *undisturbed(range(self.end, self.length))], key=lambda one: one.arrives_ns
        )
        self.held_ns = max((one.held_ns for one in faults.times), default=0)

    def frame(self, one: Delivery) -> Frame | None:
        """Frame as its driver delivers it; None if the driver assigns no time to it."""
        k = (one.true_ns - START_NS) // PERIOD_NS
        pixels = self.pixels.get((one.camera, k))
        if pixels is None:
            pixels = self.clip.snap(self.clip.scene(one.camera, k), k, self.rng)
        pixels.flags.writeable = False
        t_ns = self._clocks[one.camera].host_ns(one.t_ns, one.arrives_ns) if self._own_clock else one.t_ns
        if t_ns is None:
            return None
        return Frame(one.camera, one.sequence, t_ns, pixels, self.bits, exposure_ms=1.0)

    def error_of(self, one: Published, t_ns: float, now_ns: int) -> FloatArray:
        """Error of a value at ``t_ns``, shown at ``now_ns``: x and y in mm, yaw and pitch in °.

        For a fault of times, the value may be from any time that may be displayed.
        """
        assert one.values is not None  # noqa: S101  checked by the judge
        if self.faults.spoil.no_beam and self.onset_ns <= t_ns + PERIOD_NS / 2 < self.end_ns:
            return np.full(4, np.inf)
        truth = self._places(self._truth, exposures_ns(t_ns, one.frames)).mean(axis=0)
        error = np.asarray(np.abs(truth - one.values))
        if not self.faults.times:
            return error
        at_ns = np.linspace(now_ns - MAX_AGE_S * 1e9, now_ns, 240)
        assert one.sigma is not None  # noqa: S101  as the values
        return error_of_times(np.abs(self._places(self._path, at_ns) - one.values), error, one.sigma)

    def _places(self, path: FloatArray, at_ns: FloatArray) -> FloatArray:
        times_ns = START_NS + PERIOD_NS * np.arange(self.length)
        return np.stack([np.interp(at_ns, times_ns, column) for column in path.T], axis=1)


def _window_means(truth: FloatArray) -> FloatArray:
    """Path of the window's mean about each exposure: vibration is averaged as in a window."""
    padded = np.pad(truth, ((WINDOW // 2, WINDOW - WINDOW // 2 - 1), (0, 0)), mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, WINDOW, axis=0).mean(axis=-1))


def run_episode(
    rig: SimulatedRig, faults: Drawn, rng: np.random.Generator, places: Interfaces, has_broker: bool
) -> Result:
    """Run a daemon through the faults and judge the outputs of all its interfaces.

    If it does not measure again in time, it is compared with one without the faults: the beam may have moved
    to a place where every unit refuses it.
    """

    def run(drawn: Drawn, rng: np.random.Generator, steady_ns: float) -> Judge:
        film = _Film(rig, drawn, rng)
        with (
            tempfile.TemporaryDirectory(prefix="altd-faults-") as folder,
            contextlib.closing(TelegramLine(Path(folder, "ttyUSB0"))) as telegram,
        ):
            return asyncio.run(_run(rig, film, places, telegram, has_broker, steady_ns))

    same_rng = copy.deepcopy(rng)
    judge = run(faults, rng, _STEADY_NS)
    if not judge.result.is_back:
        judge.time_recovery(run(faults.without_effect(), same_rng, math.inf).refusals)
        judge.result.back_by_comparison = judge.result.is_back
    return judge.result


async def _run(
    rig: SimulatedRig,
    film: _Film,
    places: Interfaces,
    telegram: TelegramLine,
    has_broker: bool,
    steady_ns: float,
) -> Judge:
    pair_by = film.faults.times[0].pair_by if film.faults.times else "time"
    judge = Judge(film.error_of, film.onset_ns, film.end_ns, film.held_ns)
    async with (
        live_unit(rig, places, telegram.device, START_NS, Measuring(pair_by=pair_by)) as unit,
        wires_of(places, telegram, unit.socket, has_broker) as wires,
    ):
        waiting = list(reversed(film.arrivals))
        acts = [act(unit, wires, Draw(film.rng)) for act in film.faults.acts]
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
            judge.take(shown, now_ns, START_UTC + unit.clock.utc_step)
            is_back = judge.back_ns is not None and now_ns - judge.back_ns > steady_ns
            if is_back or now_ns - film.end_ns > BACK * PERIOD_NS:
                break
    return judge
