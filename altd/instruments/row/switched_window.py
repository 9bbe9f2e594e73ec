"""Window of a beam whose targets are shown in turn: a switched front target, and those behind it.

Each target has its own exposures at its own times. A straight line through those of a target gives its spot
at the middle of all exposures, which removes steady motion between two targets. Vibration remains: it moves
the spots between the visits, and their scatter about the line is the uncertainty.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import chain

import numpy as np

from altd.instruments.row.glass import INVALIDATING, GlassCheck
from altd.instruments.row.rounds import Observation, RoundWindow
from altd.measuring.averaging import mean_spots
from altd.reasons import Reason
from altd.records import Fault, FloatArray, FrameSet, MeanSpots, Spot
from altd.records.spots import SpotMotion

MIN_VISITS = 4
"""Minimum visits of each target in a window: two determine a line, the others its uncertainty."""
_MEMORY_NS = 30 * 10**9
"""Time over which the scatter of windows is averaged: four visits alone may be on a line by chance."""
_EXPOSURES_WEIGHT = 0.5
"""Weight of the scatter of single exposures, in degrees of freedom of the scatter of visits."""
_ALL = 10**6


class SwitchedWindow:
    """Last visits of each target, with ``window`` exposures or more; see ``measuring.averaging.Window``.

    There are at least MIN_VISITS visits. Faults of a glass are detected when a round of all targets has
    ended. A fault that invalidates its spot drops the exposures; there is no mean until a round without such
    a fault.
    """

    def __init__(self, targets: tuple[str, ...], window: int, every: int) -> None:
        self._targets = targets
        self._size = window
        self._every = every
        self._rounds = RoundWindow(targets)
        self._glasses = GlassCheck(targets, _ALL)
        self._faults: tuple[Fault, ...] = ()
        """Faults of the glasses in the last round."""
        self._scatter: dict[str, deque[tuple[int, float]]] = {target: deque() for target in targets}
        """Times and variances (px²) of the line at the middle in earlier windows, by target."""
        self.begin()

    def begin(self, window: int | None = None) -> None:
        """See ``Window``."""
        self._size = window or self._size
        self._since_mean = 0
        self.forget()

    def forget(self) -> None:
        """See ``Window``."""
        self._visits: dict[str, deque[list[FrameSet]]] = {target: deque() for target in self._targets}
        self._is_new_visit = True
        self._rounds.forget()

    def skip(self, sequence: int) -> None:
        """See ``Window``: the targets are being switched, or the frame LEDs are lit."""
        self._is_new_visit = True

    def add(self, frame_set: FrameSet) -> MeanSpots | tuple[Fault, ...] | None:
        """See ``Window``; a frame set of a target that is not part of the unit is not measured."""
        if (visits := self._visits.get(frame_set.opaque)) is None:
            return None
        self._inspect_glasses(frame_set)
        self._drop_stale(frame_set.t_ns)
        if self._is_new_visit or not visits:
            self._is_new_visit = False
            visits.append([])
        shown = {frame_set.opaque: frame_set.spots[frame_set.opaque]}
        visits[-1].append(replace(frame_set, spots=shown))
        del visits[-1][: -self._size]  # an endless visit must not fill the memory
        while len(visits) > MIN_VISITS and sum(map(len, visits)) - len(visits[0]) >= self._size:
            visits.popleft()
        self._since_mean += 1
        if self._since_mean < self._every:
            return None
        self._since_mean = 0
        if self._is_unbelievable:
            return self._faults
        mean = self._mean()
        return mean if isinstance(mean, MeanSpots) else (*mean, *self._faults)

    def _drop_stale(self, now_ns: int) -> None:
        """Drop the visits of a target that is no longer shown.

        In any order of the rounds, the pause between two visits is shorter than the time of four visits.
        """
        for visits in self._visits.values():
            if visits:
                last_ns = visits[-1][-1].t_ns
                span_ns = last_ns - visits[0][0].t_ns if len(visits) >= MIN_VISITS else _MEMORY_NS
                if now_ns - last_ns > span_ns:
                    visits.clear()

    @property
    def _is_unbelievable(self) -> bool:
        return any(fault.reason in INVALIDATING for fault in self._faults)

    def _inspect_glasses(self, frame_set: FrameSet) -> None:
        for target in self._targets:
            observation = Observation(
                target, frame_set.opaque, frame_set.sequence, frame_set.t_ns, frame_set.spots[target]
            )
            if (ended := self._rounds.add(observation)) is None:
                continue
            faults = self._glasses.inspect(ended).faults
            self._faults = tuple(Fault(reason, name) for name, of in faults.items() for reason in of)
            if self._is_unbelievable:
                for visits in self._visits.values():
                    visits.clear()

    def _mean(self) -> MeanSpots | tuple[Fault, ...]:
        lines = []
        for target, visits in self._visits.items():
            shown = list(chain.from_iterable(visits))
            line = mean_spots(shown, (target,), len(shown)) if shown else ()
            usable = sum(any(not one.faults() for one in visit) for visit in visits)
            if isinstance(line, MeanSpots) and line.motion is not None and usable >= MIN_VISITS:
                lines.append(line)
                continue
            missing = tuple(fault for one in shown for fault in one.faults())[-1:]
            faults = missing if isinstance(line, MeanSpots) else line
            if usable < MIN_VISITS:  # two visits of a moving beam are at two places
                faults = tuple(fault for fault in faults if fault.reason is not Reason.UNSTEADY)
            detail = f"{usable} of {MIN_VISITS} visits of {target}"
            return faults or (Fault(Reason.WARMING_UP, detail=detail),)
        frames = sum(line.frames for line in lines)
        t_ns = lines[0].t_ns + round(sum((at.t_ns - lines[0].t_ns) * at.frames for at in lines) / frames)
        return _together([self._at(line, line.motion, t_ns) for line in lines if line.motion], t_ns)

    def _at(self, line: MeanSpots, motion: SpotMotion, t_ns: int) -> MeanSpots:
        """Spot of a target at ``t_ns``; its scatter is at least that of the earlier windows."""
        at_s, (target,) = (t_ns - line.t_ns) * 1e-9, line.targets
        covariance_px2, before = self._line_covariance(target, line, motion, at_s), self._scatter[target]
        while before and before[0][0] < t_ns - _MEMORY_NS:
            before.popleft()
        variance_px2 = float(np.trace(covariance_px2)) / 2.0
        before.append((t_ns, variance_px2))
        covariance_px2 *= max(1.0, sum(of for _, of in before) / len(before) / variance_px2)
        excess_px = line.excess_px[0] if line.excess_px else 0.0
        without_excess_px2 = float(np.trace(line.covariance_px2)) / 2.0 - excess_px**2
        scale = max(1.0, float(np.trace(covariance_px2)) / 2.0 / without_excess_px2)
        return replace(
            line,
            px=line.px + at_s * motion.rate_px_per_s,
            covariance_px2=covariance_px2 + excess_px**2 * np.eye(2),
            t_ns=t_ns,
            motion=replace(
                motion,
                rate_covariance=motion.rate_covariance * scale,
                onset_s=motion.onset_s - at_s,
                newest_s=motion.newest_s - at_s,
            ),
        )

    def _line_covariance(self, target: str, line: MeanSpots, motion: SpotMotion, at_s: float) -> FloatArray:
        """Covariance (2, 2) px² of a line at ``at_s`` after its middle.

        Exposures of one visit share its vibration. The scatter of visits therefore counts, as in the
        cluster-robust covariance of least squares; that of single exposures has little weight.
        """
        rows = [
            (number, (one.t_ns - line.t_ns) * 1e-9, spot.u_px, spot.v_px, spot.sigma_px)
            for number, visit in enumerate(self._visits[target])
            for one in visit
            if isinstance(spot := one.spots[target], Spot)
        ]
        visits, t_s, u_px, v_px, noise_px = np.array(rows).T
        residuals = np.column_stack([u_px, v_px]) - line.px[0] - np.outer(t_s, motion.rate_px_per_s)
        gain = 1.0 / len(t_s) + at_s * t_s / float(t_s @ t_s)
        names = np.unique(visits)
        sums = np.array([gain[visits == name] @ residuals[visits == name] for name in names])
        freedom = len(names) - 2.0
        by_visits = sums.T @ sums * len(names) / freedom
        single = residuals.T @ residuals + 2.0 * float(np.median(noise_px)) ** 2 * np.eye(2)
        by_exposures = single / len(t_s) * float(gain @ gain)
        total: FloatArray = (freedom * by_visits + _EXPOSURES_WEIGHT * by_exposures) / (
            freedom + _EXPOSURES_WEIGHT
        )
        return total


def _together(parts: list[MeanSpots], t_ns: int) -> MeanSpots:
    """Combine the spots of all targets at one instant; different targets scatter independently."""
    motions = [part.motion for part in parts if part.motion is not None]
    return MeanSpots(
        targets=tuple(part.targets[0] for part in parts),
        px=np.concatenate([part.px for part in parts]),
        covariance_px2=_block_diagonal([part.covariance_px2 for part in parts]),
        t_ns=t_ns,
        frames=min(part.frames for part in parts),
        lost=max(part.lost for part in parts),
        shapes=tuple(shape for part in parts for shape in part.shapes),
        shape_parts=tuple(
            tuple(shape for shapes in thirds for shape in shapes)
            for thirds in zip(*(part.shape_parts for part in parts), strict=False)
        ),
        excess_px=tuple(excess for part in parts for excess in part.excess_px),
        motion=SpotMotion(
            rate_px_per_s=np.concatenate([motion.rate_px_per_s for motion in motions]),
            rate_covariance=_block_diagonal([motion.rate_covariance for motion in motions]),
            vibration_px2=_block_diagonal([motion.vibration_px2 for motion in motions]),
            onset_px_per_s=np.concatenate([motion.onset_px_per_s for motion in motions]),
            onset_s=min(motion.onset_s for motion in motions),
            spread_s2=max(motion.spread_s2 for motion in motions),
            span_s=max(motion.span_s for motion in motions),
            newest_s=max(motion.newest_s for motion in motions),
        ),
    )


def _block_diagonal(blocks: list[FloatArray]) -> FloatArray:
    size = sum(len(block) for block in blocks)
    whole, at = np.zeros((size, size)), 0
    for block in blocks:
        whole[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return whole
