"""A second light that comes near the spot of one target while the unit measures."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support.measurements import beam_of

from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.records import Frame, Spot
from altd.vision.localise import locate
from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, Unit, UnitConfig

WINDOW, ONSET, END, EXPOSURES = 10, 15, 45, 60
PERIOD_NS = 50_000_000
POSE = BeamPose(5.0, -4.0, 0.02, -0.03)
MAX_MM, MAX_DEG = 0.15, 0.03


def lit(frame: Frame, share: float, aside_radii: float) -> Frame:
    """The frame with a second spot of the same shape, so far to the right."""
    spot = locate(frame)
    assert isinstance(spot, Spot)
    radius_px = spot.diameter_px / 2
    rows, columns = np.indices(frame.pixels.shape)
    square = (columns - spot.u_px - aside_radii * radius_px) ** 2 + (rows - spot.v_px) ** 2
    added = frame.pixels + share * spot.peak * np.exp(-2 * square / radius_px**2)
    return replace(frame, pixels=added.round().clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize(("share", "aside_radii"), [(0.1, 0.3), (0.25, 0.2), (0.25, 0.15)])
def test_it_is_in_sigma_or_the_measurement_is_invalid(
    calibration_of_unit_3: Calibration, camera: str, share: float, aside_radii: float
) -> None:
    unit = Unit(UnitConfig(seed=3))
    unit.place(POSE)
    chain = MeasuringChain(
        [View(name, name) for name in CAMERAS],
        calibration_of_unit_3,
        Measuring(window=WINDOW),
        BeamInstrument(calibration_of_unit_3, Measuring(window=WINDOW)),
    )

    def frames() -> Iterator[Frame]:
        for n in range(EXPOSURES):
            for name in CAMERAS:
                frame = unit.expose(name, n, n * PERIOD_NS)
                yield lit(frame, share, aside_radii) if name == camera and ONSET <= n < END else frame

    measured, changed = {}, {}
    for frame in frames():
        for measurement in chain.push(frame):
            measured[frame.sequence] = measurement
        changed[frame.sequence] = chain.figures().get("light_changed_rear")
    assert changed[ONSET - 1] == changed[EXPOSURES - 1] == 0.0
    assert share / 2 < changed[END - 1] < 2 * share  # of the front target it lights the glass, too
    before = beam_of(measured[ONSET - 1])
    assert before is not None
    for n, measurement in measured.items():
        beam = beam_of(measurement)
        if n < ONSET or beam is None:
            continue
        for value, truth, sigma, limit in (
            (beam.x_mm, before.x_mm, beam.sigma_x_mm, MAX_MM),
            (beam.y_mm, before.y_mm, beam.sigma_y_mm, MAX_MM),
            (beam.yaw_deg, before.yaw_deg, beam.sigma_yaw_deg, MAX_DEG),
            (beam.pitch_deg, before.pitch_deg, beam.sigma_pitch_deg, MAX_DEG),
        ):
            assert abs(value - truth) < min(5 * sigma, limit), n
    assert all(beam_of(measured[n]) is not None for n in range(END + WINDOW, EXPOSURES))
