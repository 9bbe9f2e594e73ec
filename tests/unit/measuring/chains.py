"""Chains of two cameras with a window of four, and what these cameras see."""

from collections.abc import Sequence

import numpy as np
from support.recordings import picture

from altd.config import Installation, Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import Provenance
from altd.reasons import Reason
from altd.records import Fault, Frame, Measurement

VIEWS = (View("front", "left"), View("rear", "right"))  # a camera need not be named after its target


def chain(calibration: Calibration, *origins: Reason, **installation: float) -> MeasuringChain:
    measuring = Measuring(window=4)
    return MeasuringChain(
        VIEWS,
        calibration,
        measuring,
        BeamInstrument(calibration, measuring, Installation.model_validate(installation)),
        Provenance(origins=lambda: map(Fault, origins)),
    )


def shots(places_mm: Sequence[tuple[float, float]], leds_on: bool = False, seed: int = 1) -> list[Frame]:
    rng = np.random.default_rng(seed)
    return [
        Frame(camera, number, number * 50_000_000, picture(target, x, y, rng), 8, leds_on)
        for number, (x, y) in enumerate(places_mm)
        for target, camera in (("front", "left"), ("rear", "right"))
    ]


def last(measured: MeasuringChain, frames: Sequence[Frame]) -> Measurement:
    return [measurement for frame in frames for measurement in measured.push(frame)][-1]
