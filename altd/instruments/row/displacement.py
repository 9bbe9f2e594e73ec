"""Displacements of the places since the baseline: −(the spot's movement − the beam's movement there)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from altd.instruments.row.beam import at_instant, gain_at, moved_stable
from altd.instruments.row.places import BeamPlace, systematic_mm2
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.records import FloatArray

_MIN_BASELINE_SHARE = 0.5
_PATIENCE = 3
"""Number of baselines' lengths after which stable targets that are not measured are left out."""
_MIN_CREEP_SIGMAS = 3.0
"""Minimum speed of a place during the baseline that counts as motion; less is the scatter of its visits."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Displacement (dx, dy) of a place with its covariance (2, 2), mm.

    ``random_mm2`` is the part that scatters from round to round, ``lasting_mm2`` the part of texture and map
    that a longer mean does not reduce; the rest is the baseline's.
    """

    t_ns: int
    mm: FloatArray
    covariance_mm2: FloatArray
    random_mm2: FloatArray
    lasting_mm2: FloatArray

    @property
    def significance(self) -> float:
        """√(dᵀ C⁻¹ d): length in standard deviations; without movement above 3.0 in 1 % of the rounds."""
        return math.sqrt(float(self.mm @ np.linalg.solve(self.covariance_mm2, self.mm)))


@dataclass(frozen=True, slots=True)
class Displaced:
    """Displacements of a round, by target; a target without one is absent.

    ``moved`` holds stable targets that do not fit the others. ``disagree``: some do not fit, but which ones
    is unknown. ``beam`` is the known part of the beam's movement: ``line``, ``offset`` or ``nothing``.
    """

    places: Mapping[str, Displacement] = field(default_factory=dict)
    moved: tuple[str, ...] = ()
    disagree: bool = False
    beam: str = "line"


@dataclass(frozen=True, slots=True, eq=False)
class _Epoch:
    """Spot of a target in a round, and the spots of the stable targets at that instant."""

    place: BeamPlace
    stable: Mapping[str, BeamPlace]


@dataclass(frozen=True, slots=True, eq=False)
class _Movement:
    """Movement of a spot since the baseline, (2,) mm, and the parts of its covariance (2, 2)."""

    mm: FloatArray
    random_mm2: FloatArray
    baseline_mm2: FloatArray
    lasting_mm2: FloatArray

    @property
    def covariance_mm2(self) -> FloatArray:
        return self.random_mm2 + self.baseline_mm2 + self.lasting_mm2


@dataclass(frozen=True, slots=True, eq=False)
class BaselineMeans:
    """Mean of each spot over the baseline's rounds; ``random_mm2`` of these places is that of the mean.

    ``own`` holds the targets that were measured in at least half of the rounds, without the stable targets
    that were left out. ``stable`` holds, by target and stable target, the means of the stable target at the
    instants of the target's visits. ``simulated``: the means were stored, and made from simulated frames.
    """

    own: Mapping[str, BeamPlace]
    stable: Mapping[str, Mapping[str, BeamPlace]]
    simulated: bool = False


class Baseline:
    """Baseline: the first rounds with all stable targets measured, or stored means; movements since."""

    def __init__(
        self,
        calibration: Calibration,
        stable: Sequence[str],
        rounds: int,
        means: BaselineMeans | None = None,
    ) -> None:
        self._targets: dict[str, TargetCalibration] = {of.name: of for of in calibration.targets}
        self._limits = calibration.limits
        self._stable = tuple(stable)
        self._rounds = rounds
        self._seen: deque[Mapping[str, BeamPlace]] = deque(maxlen=_PATIENCE * rounds)
        self.means = means
        """Means of the baseline; None while it is not complete."""

    @property
    def is_complete(self) -> bool:
        """Whether the baseline is complete, so that displacements can be computed."""
        return self.means is not None

    def has(self, target: str) -> bool:
        """Whether a target was measured in at least half of the baseline's rounds."""
        return self.means is not None and target in self.means.own

    def collect(self, places: Mapping[str, BeamPlace], history: Mapping[str, Sequence[BeamPlace]]) -> None:
        """Add a round; complete the baseline with the first rounds in which all stable targets were measured.

        If there are too few in ``_PATIENCE`` times as many rounds, the stable targets that were measured
        least are left out, but not all of them: the others determine the beam.
        """
        if not places:
            return
        self._seen.append(places)
        stable = sorted(self._stable, key=lambda name: -sum(name in of_round for of_round in self._seen))
        least = len(stable) if len(self._seen) < _PATIENCE * self._rounds else min(len(stable), 1)
        for count in range(len(stable), least - 1, -1):
            known = [of_round for of_round in self._seen if of_round.keys() >= set(stable[:count])]
            if len(known) >= self._rounds:
                epochs = [self._epochs_of(of_round, history) for of_round in known[: self._rounds]]
                self.means = self._means(epochs, [name for name in self._stable if name in stable[:count]])
                self._seen.clear()
                return

    def _means(self, rounds: Sequence[Mapping[str, _Epoch]], stable: Sequence[str]) -> BaselineMeans:
        names = [name for name in self._targets if name in stable or name not in self._stable]
        of = {name: [epochs[name] for epochs in rounds if name in epochs] for name in names}
        known = {name: epochs for name, epochs in of.items() if _is_enough(len(epochs), self._rounds)}
        return BaselineMeans(
            {name: self._mean_of_place(name, epochs, stable) for name, epochs in known.items()},
            {
                name: {other: _mean([epoch.stable[other] for epoch in epochs]) for other in stable}
                for name, epochs in known.items()
            },
        )

    def _mean_of_place(self, name: str, epochs: Sequence[_Epoch], stable: Sequence[str]) -> BeamPlace:
        """Mean of a place. Its variance contains steady motion of the place, but not of the beam.

        A displacement counts from the baseline's start, middle or end alike: their mean square is twice that
        of all its moments.
        """
        mean = _mean([epoch.place for epoch in epochs])
        reference = _reference(name, stable)
        if len(reference) < 2 or len(epochs) < 2:  # the beam's motion is not known
            return mean
        z_mm = [self._targets[other].z_mm for other in reference]
        gain = gain_at(z_mm, [np.eye(2)] * len(z_mm), self._targets[name].z_mm)
        mm, variances = np.zeros((2, len(epochs), 2))
        for index, epoch in enumerate(epochs):
            spots = [epoch.stable[other] for other in reference]
            mm[index] = epoch.place.mm - gain @ np.concatenate([spot.mm for spot in spots])
            of_beam = np.concatenate([spot.random_mm2.diagonal() for spot in spots])
            variances[index] = epoch.place.random_mm2.diagonal() + gain**2 @ of_beam
        since_s = np.array([(epoch.place.t_ns - mean.t_ns) * 1e-9 for epoch in epochs])
        since_s -= since_s.mean()
        square_s2 = since_s @ since_s
        rate, variance = since_s @ mm / square_s2, since_s**2 @ variances / square_s2**2
        moved_mm2 = (rate**2 - variance) * (rate**2 > _MIN_CREEP_SIGMAS**2 * variance)
        return replace(mean, random_mm2=mean.random_mm2 + np.diag(moved_mm2) * 2.0 * square_s2 / len(epochs))

    def displaced(
        self, places: Mapping[str, BeamPlace], history: Mapping[str, Sequence[BeamPlace]]
    ) -> Displaced:
        """Displacements of a round; ``history`` holds each target's visits, before and after it too."""
        epochs = {name: epoch for name, epoch in self._epochs_of(places, history).items() if self.has(name)}
        stable = [name for name in self._stable if name in epochs]
        moved = self._moved_stable(stable, epochs)
        if moved is None:
            return Displaced(disagree=True)
        stable = [name for name in stable if name not in moved]
        own = {name: self._own_movement(name, epoch) for name, epoch in epochs.items()}
        unknown_mm2 = _unknown_beam_mm2(own, {name: self._targets[name].z_mm for name in own}, stable)
        found = {}
        for name, epoch in epochs.items():
            reference = _reference(name, stable)
            found[name] = self._displacement(name, epoch, own[name], reference, unknown_mm2[name])
        return Displaced(found, moved, beam=("nothing", "offset", "line")[min(len(stable), 2)])

    def _moved_stable(self, stable: Sequence[str], epochs: Mapping[str, _Epoch]) -> tuple[str, ...] | None:
        """See ``moved_stable``; all at the instant of one of them, because the beam drifts within a round."""
        if len(stable) < 3:  # two targets fit any beam
            return ()
        at = stable[len(stable) // 2]
        movements = {name: self._movement(at, name, epochs[at]) for name in stable}
        return moved_stable(
            {name: self._targets[name].z_mm for name in stable},
            {name: of.mm for name, of in movements.items()},
            {name: of.covariance_mm2 for name, of in movements.items()},
        )

    def _displacement(
        self, name: str, epoch: _Epoch, own: _Movement, reference: Sequence[str], unknown_mm2: FloatArray
    ) -> Displacement:
        """Displacement of one place against the stable targets ``reference``.

        With two stable targets or fewer, each of them defines the beam: its displacement is 0 by definition,
        and its sigma is that of its own movement.
        """
        movements = [self._movement(name, other, epoch) for other in reference]
        zeros = np.zeros((2, 2))
        random, baseline, lasting = own.random_mm2, own.baseline_mm2, own.lasting_mm2 + unknown_mm2
        mm = np.zeros(2)
        if name not in reference:
            mm = -own.mm
            if reference:
                gain = gain_at(
                    [self._targets[other].z_mm for other in reference],
                    [of.covariance_mm2 for of in movements],
                    self._targets[name].z_mm,
                )
                mm = mm + gain @ np.concatenate([of.mm for of in movements])
                parts = [zeros, zeros, zeros]
                for index, of in enumerate(movements):
                    each = gain[:, 2 * index : 2 * index + 2]
                    of_parts = (of.random_mm2, of.baseline_mm2, of.lasting_mm2)
                    parts = [
                        total + each @ part @ each.T for total, part in zip(parts, of_parts, strict=True)
                    ]
                random, baseline, lasting = random + parts[0], baseline + parts[1], lasting + parts[2]
        return Displacement(epoch.place.t_ns, mm, random + baseline + lasting, random, lasting)

    def _epochs_of(
        self, places: Mapping[str, BeamPlace], history: Mapping[str, Sequence[BeamPlace]]
    ) -> dict[str, _Epoch]:
        epochs = {}
        for name, place in places.items():
            instants = {other: at_instant(history.get(other, ()), place.t_ns) for other in self._stable}
            epochs[name] = _Epoch(place, {k: v for k, v in instants.items() if v is not None})
        return epochs

    def _own_movement(self, name: str, epoch: _Epoch) -> _Movement:
        assert self.means is not None  # noqa: S101  checked before
        return self._since(name, self.means.own[name], epoch.place)

    def _movement(self, name: str, stable: str, epoch: _Epoch) -> _Movement:
        """Movement of a stable target from the instants of ``name`` in the baseline to the current one."""
        assert self.means is not None  # noqa: S101  checked before
        return self._since(stable, self.means.stable[name][stable], epoch.stable[stable])

    def _since(self, name: str, mean: BeamPlace, now: BeamPlace) -> _Movement:
        lasting = systematic_mm2(self._targets[name], self._limits, now, mean)
        return _Movement(now.mm - mean.mm, now.random_mm2, mean.random_mm2, lasting)


def _reference(name: str, stable: Sequence[str]) -> Sequence[str]:
    """Stable targets that show the beam at a target: of three or more, each is measured by the others."""
    return [other for other in stable if other != name] if len(stable) > 2 else stable


def _is_enough(rounds: int, of_rounds: int) -> bool:
    return rounds >= _MIN_BASELINE_SHARE * of_rounds


def _mean(places: Sequence[BeamPlace]) -> BeamPlace:
    """Mean place of several visits, with the variance of the mean."""
    return replace(
        places[0],
        mm=np.mean([each.mm for each in places], axis=0),
        random_mm2=np.sum([each.random_mm2 for each in places], axis=0) / len(places) ** 2,
        excess_mm2=float(np.mean([each.excess_mm2 for each in places])),
    )


def _unknown_beam_mm2(
    own: Mapping[str, _Movement], z_mm: Mapping[str, float], stable: Sequence[str]
) -> dict[str, FloatArray]:
    """Variance (2, 2) at each target by beam movement that the stable targets do not determine.

    With fewer than two of them, the movement common to all targets is taken as one sigma of the beam's
    possible movement: with one stable target the angle about it, with none also the offset.
    """
    if len(stable) > 1 or not own:
        return {name: np.zeros((2, 2)) for name in own}
    z = np.array([z_mm[name] for name in own])
    moved = np.array([movement.mm for movement in own.values()])
    anchor_mm, held = (
        (z_mm[stable[0]], own[stable[0]].mm) if stable else (float(z.mean()), moved.mean(axis=0))
    )
    lever = z - anchor_mm
    slope = lever @ (moved - held) / max(float(lever @ lever), 1e-9)
    offset = np.zeros(2) if stable else held
    return {name: np.diag((offset + slope * (z_mm[name] - anchor_mm)) ** 2) for name in own}
