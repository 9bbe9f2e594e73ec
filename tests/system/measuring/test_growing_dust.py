"""Dust that settles from day to day, and a second light near the spot.

Both are hw_sim's, which shares no code with what looks for them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from support.measurements import beam_chain, beam_of

from altd.calibration.result import CalibrationResult
from altd.config import Maintenance, Measuring
from altd.measuring.calibration import Calibration
from altd.records import Frame, Measurement, Spot
from altd.status.maintenance import SpotTrends
from altd.vision.localise import locate
from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.dust import Dust, make_dust
from hw_sim.measure import HALF_AREA_MM
from hw_sim.unit import CAMERAS, Unit, UnitConfig

PERIOD_NS = 50_000_000
EXPOSURES = 2
"""At each place."""
PLACES = 60
"""Of five minutes: dust is looked for once in five seconds."""


def poses(seed: int) -> list[BeamPose]:
    """Beams within both targets."""
    rng = np.random.default_rng(seed)
    found: list[BeamPose] = []
    while len(found) < PLACES:
        front = rng.uniform(-0.8, 0.8, 2) * HALF_AREA_MM
        slope = rng.uniform(-0.08, 0.08, 2)
        if (np.abs(front + 280.0 * slope) < 0.85 * np.array(HALF_AREA_MM)).all():
            found.append(BeamPose(*front, *slope))
    return found


@dataclass
class Period:
    """The result of five minutes: the reported causes, how many measurements are good, and how wrong."""

    told: set[tuple[str, str | None]]
    share: dict[str, float]
    valid: int = 0
    errors_sigmas: list[float] = field(default_factory=list)

    @property
    def rms_sigmas(self) -> float:
        return math.sqrt(float(np.mean(np.square(self.errors_sigmas))))


class LivedIn:
    """A unit in the tunnel; its beam goes from place to place."""

    def __init__(self, calibration: Calibration, config: UnitConfig) -> None:
        self.unit = Unit(config)
        self._calibration = calibration
        self._t_ns = 0

    def five_minutes(self, seed: int = 0) -> Period:
        """A window of exposures at each of many places."""
        chain = beam_chain(self._calibration, Measuring(window=EXPOSURES))
        trends = SpotTrends({camera: camera for camera in CAMERAS}, Maintenance())
        period = Period(set(), {})
        for pose in poses(seed):
            self.unit.place(pose)
            self._t_ns += 5 * 10**9
            last: Measurement | None = None
            for exposure in range(EXPOSURES):
                t_ns = self._t_ns + exposure * PERIOD_NS
                for camera in CAMERAS:
                    frame = self.unit.expose(camera, t_ns // PERIOD_NS, t_ns)
                    for pair in chain.pairer.add(camera, frame.sequence, t_ns, frame):
                        located = pair.converted(chain.located)
                        for one in located.all_items:
                            trends.add(one)
                        last = chain.add(located) or last
            assert last is not None
            self._judge(last, pose, period)
        period.told = {(str(cause.kind), cause.of) for cause in trends(self._t_ns)}
        period.share = {camera: trends.dust[camera].share or 0.0 for camera in CAMERAS}
        return period

    def _judge(self, measurement: Measurement, pose: BeamPose, period: Period) -> None:
        period.valid += measurement.valid
        if not measurement.valid:
            return
        truth = {"x_mm": pose.x_mm, "y_mm": pose.y_mm, "yaw_deg": pose.yaw_deg, "pitch_deg": pose.pitch_deg}
        for key, true in truth.items():
            number, sigma = measurement.number(key), measurement.sigma(key)
            assert number is not None
            assert sigma is not None
            period.errors_sigmas.append((number - true) / sigma)


def covered(unit: Unit, layers: int) -> None:
    """Several times the heaviest dust on both targets, and the window's shadow on the rear one."""
    for number, camera in enumerate(CAMERAS):
        passes = np.prod(
            [make_dust(1.0, np.random.default_rng([number, layer])).transmission for layer in range(layers)],
            axis=0,
        )
        unit.imagers[camera].set_dust(Dust(passes.astype(np.float32)))


def test_growing_dust_is_told_long_before_a_measurement_is_refused_or_wrong(
    calibration_of_unit_3: Calibration,
) -> None:
    lived = LivedIn(calibration_of_unit_3, UnitConfig(seed=3))
    clean = lived.five_minutes()
    assert clean.told == set()
    assert max(clean.share.values()) < 0.0001
    grown = []
    for amount in (0.02, 0.1, 0.2):
        lived.unit.set_dust(amount)
        grown.append(lived.five_minutes())
    for period in grown:
        assert period.valid == PLACES
        assert period.rms_sigmas < 1.25
    for camera in CAMERAS:
        told = [("dusty", camera) in period.told for period in grown]
        assert told[1:] == [True, True]
        shares = [period.share[camera] for period in grown]
        assert shares == sorted(shares)
        assert 0.0005 < shares[-1] < 0.004  # specks cover 0.2 %, on the rear target the window's shadow too
    covered(lived.unit, 2)
    refused = lived.five_minutes()
    assert 0 < refused.valid < PLACES / 2  # of ten times the dust that was reported already
    assert refused.rms_sigmas < 1.25


def test_single_specks_on_a_target_with_a_flat_are_in_sigma(
    unit_3_with_flat: CalibrationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a flat sigma is smallest, 0.003 mm, and specks move an unguarded fit by 0.04 mm.

    The fit leaves the darkest blocks out, and what it does not explain adds to sigma: without these two up to
    one number in twenty was off by more than 4 sigma, the worst by 11.
    """
    monkeypatch.setattr("hw_sim.dust.SMEAR_LOSS", (0.0, 0.0))  # the specks alone
    lived = LivedIn(unit_3_with_flat.calibration, UnitConfig(seed=3))
    for amount in (0.0, 0.02, 0.1, 0.3):
        lived.unit.set_dust(amount)
        period = lived.five_minutes()
        assert period.valid == PLACES
        assert 0.3 < period.rms_sigmas < 1.0
        assert np.abs(period.errors_sigmas).max() < 4.0


@pytest.mark.parametrize(
    "change", ["dim", "bright", "ambient light", "coarse light", "moved", "turned", "12 bits"]
)
def test_what_is_no_dust_is_not_told_as_dust(change: str, calibration_of_unit_3: Calibration) -> None:
    config = UnitConfig(
        seed=3, lux=1000.0 if change == "ambient light" else 200.0, bits=12 if change == "12 bits" else 8
    )
    lived = LivedIn(calibration_of_unit_3, config)
    for camera in CAMERAS:
        if change in ("dim", "bright"):
            lived.unit.set_camera(camera, exposure_ms=0.4 if change == "dim" else 2.6)
        if change == "coarse light":
            lived.unit.set_camera(camera, gain=4.0, exposure_ms=0.4)
        if change in ("moved", "turned"):
            turn_deg = 0.03 if change == "turned" else 0.0
            lived.unit.displace(camera, Displacement((0.15, -0.2), turn_deg=turn_deg))
    period = lived.five_minutes()
    assert period.valid > 0.5 * PLACES
    assert max(period.share.values()) < 0.0001
    assert "dusty" not in {code for code, _ in period.told}


WINDOW, ONSET, END, LAST = 10, 12, 30, 42
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
    chain = beam_chain(calibration_of_unit_3, Measuring(window=WINDOW))

    def frames() -> Iterator[Frame]:
        for n in range(LAST):
            for name in CAMERAS:
                frame = unit.expose(name, n, n * PERIOD_NS)
                yield lit(frame, share, aside_radii) if name == camera and ONSET <= n < END else frame

    measured, changed = {}, {}
    for frame in frames():
        for measurement in chain.push(frame):
            measured[frame.sequence] = measurement
        changed[frame.sequence] = chain.figures().get("light_changed_rear")
    assert changed[ONSET - 1] == changed[LAST - 1] == 0.0
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
    assert all(beam_of(measured[n]) is not None for n in range(END + WINDOW, LAST))
