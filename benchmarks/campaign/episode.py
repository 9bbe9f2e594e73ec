"""One episode: clean exposures, then disturbed ones, through the daemon's own measuring chain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from altd.config import Measuring
from altd.measuring.chain import MeasuringChain
from altd.reasons import Reason
from altd.records import FloatArray, Frame, Measurement
from benchmarks.campaign.clips import Clip, Rig, t_ns_of
from benchmarks.campaign.judge import Judgement, Outcome, Verdict, judge, truth_of
from benchmarks.campaign.scene import Scene
from benchmarks.campaign.units import chain_of
from benchmarks.campaign.way import CAMERAS, Shot, Spoil, spoil_pixels
from benchmarks.campaign.ways.numbers import Misnumbered, accepted

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
    shots = _shots(clip, spoil, rng, onset, rig.bits)
    if foreign is not None:
        others = _shots(foreign.clip(rng, clip.length, moving), spoil, rng, onset, foreign.bits)
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
    measured = _measured(chain, _shots(clip, Spoil(way.note), rng, 0, rig.bits))
    judged = [judge(one, None if way.is_none else clip.truth(k)) for k, one in measured]
    return Outcome((), tuple(one for one in judged if one.reasons != _WARMING_UP))


def _shots(clip: Clip, spoil: Spoil, rng: np.random.Generator, onset: int, bits: int) -> list[Shot]:
    shots = []
    kept: dict[str, Scene] = {}
    for k in range(clip.length):
        for camera in CAMERAS:
            scene = clip.scene(camera, k)
            if spoil.light is not None and k >= onset and camera in spoil.cameras:
                if camera not in kept or not clip.still or spoil.varies:
                    kept[camera] = spoil.light(scene, k - onset)
                scene = kept[camera]
            shots.append(Shot(camera, k, k + 1000, t_ns_of(k), clip.snap(scene, k, rng), bits))
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
    times_ns = np.array([t_ns_of(n) for n in window], dtype=np.float64)
    has_ended = ended is not None and k >= ended
    if has_ended and (not len(window) or abs(measurement.t_ns - times_ns.mean()) > _SAME_TIME_NS):
        return None
    return truth_of(measurement, np.array([truth[n] for n in window]), times_ns)
