"""Undisturbed operation: hours of measuring with only dust, vibration, changing light and slow drift.

Time is thinned out: every ``step_s`` of the unit's operation the cameras expose ``BURST`` times at their
rate, with new noise, through a chain that runs for an hour. Every refusal or warning is a false alarm.
"""

from __future__ import annotations

import json
import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from altd.config import Measuring
from altd.measuring.chain import MeasuringChain
from altd.records import FloatArray, Frame, Measurement, NoSpot
from benchmarks.campaign.clips import place_of
from benchmarks.campaign.judge import Verdict, arrays, judge, truth_of
from benchmarks.campaign.runner import workers
from benchmarks.campaign.scene import Noise, mean_image, noisy_image
from benchmarks.campaign.units import ROOT, SIMULATED, calibrated, chain_of, hash_of
from benchmarks.campaign.way import CAMERAS, PERIOD_NS
from benchmarks.harness import Columns
from hw_sim.beam import BeamPose, Footprint
from hw_sim.measure import HALF_AREA_MM, MAX_PITCH_SLOPE, MAX_YAW_SLOPE
from hw_sim.motion import Vibration
from hw_sim.sensor import Sensor
from hw_sim.unit import Unit

WINDOW, BURST = 20, 26
HOUR_S = 3600.0

_DRIVING_S = 420.0
"""Duration of the path across the target and back, s, at up to 1 mm/s: machines drive this fast along the
tunnel, not across it."""


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Conditions of a unit. ``lux_of`` is the ambient light at ``t_s``; drifts are shares per day."""

    unit: str
    dust: float = 0.0
    vibration: Vibration | None = None
    lux_of: Callable[[float], float] = lambda t_s: 200.0
    size_drift: float = 0.02
    power_drift: float = 0.05
    way_s: float = 700.0
    """Duration of the machine's path from one end of the target to the other and back."""


def _steps(t_s: float) -> float:
    """Ambient light that is switched every seven minutes, between 0 and 1000 lx."""
    return (0.0, 300.0, 1000.0, 60.0, 700.0)[int(t_s // 420.0) % 5]


def _flicker(t_s: float) -> float:
    """Lamps on 50.02 Hz: their 100 Hz light beats slowly with the cameras."""
    return 400.0 * (1.0 + 0.4 * math.sin(2.0 * math.pi * 100.04 * t_s))


def _slow(t_s: float) -> float:
    """Daylight: from darkness to 1000 lx and back within two hours."""
    return 500.0 * (1.0 - math.cos(2.0 * math.pi * t_s / 7200.0))


GOOD: dict[str, Circumstances] = {
    "dusty": Circumstances("plain", dust=0.3),
    "shaking": Circumstances("shaking", vibration=Vibration()),
    "lights": Circumstances("flat", lux_of=_steps),
    "flicker": Circumstances("ellipse", lux_of=_flicker, size_drift=0.04, power_drift=0.1),
    "driving": Circumstances(
        "bits-12", dust=0.1, vibration=Vibration(0.02, 0.05), lux_of=_slow, way_s=_DRIVING_S
    ),
}


@dataclass(slots=True)
class Count:
    """Sums over one part of a unit's operation."""

    measurements: int = 0
    valid: int = 0
    wrong: int = 0
    frames: int = 0
    invalid: Counter[str] = field(default_factory=Counter)
    warned: Counter[str] = field(default_factory=Counter)
    frames_refused: Counter[str] = field(default_factory=Counter)
    squares: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Σ (error/sigma)² of x, y, yaw, pitch."""
    largest_sigmas: float = 0.0

    def merge(self, other: Count) -> None:
        """Add another part."""
        for name in ("measurements", "valid", "wrong", "frames", "invalid", "warned", "frames_refused"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.squares = [mine + theirs for mine, theirs in zip(self.squares, other.squares, strict=True)]
        self.largest_sigmas = max(self.largest_sigmas, other.largest_sigmas)

    @property
    def rms(self) -> list[float]:
        """RMS of error/sigma of x, y, yaw, pitch; NaN without a valid measurement."""
        return [math.sqrt(square / self.valid) if self.valid else math.nan for square in self.squares]

    def as_json(self) -> str:
        """JSON text for the file of results."""
        return json.dumps({part.name: getattr(self, part.name) for part in fields(self)})

    @classmethod
    def of_json(cls, text: str) -> Count:
        """Parse the output of ``as_json``."""
        document = json.loads(text)
        for key in ("invalid", "warned", "frames_refused"):
            document[key] = Counter(document[key])
        return cls(**document)


class _GoodUnit:
    """A unit under its conditions."""

    def __init__(self, lives: Circumstances) -> None:
        spec = SIMULATED[lives.unit]
        self.lives = lives
        self.calibration = calibrated(lives.unit)
        self.unit = Unit(replace(spec.config, vibration=lives.vibration, dust=lives.dust))
        self.unit.follow(self.pose)
        self.exposure_ms = spec.exposure_ms
        self.sensor = Sensor(spec.config.bits)
        self.noise = Noise(spec.config.seed)
        self.distance_mm = spec.config.target_distance_mm

    def pose(self, t_ns: int) -> BeamPose:
        """Pose at ``t_ns``, over the whole area of both targets, on paths that do not repeat."""
        turns = 2.0 * math.pi * t_ns * 1e-9 / self.lives.way_s
        places = []
        for half_mm, slope, first, second in zip(
            HALF_AREA_MM, (MAX_YAW_SLOPE, MAX_PITCH_SLOPE), (1.0, 1.318), (0.713, 0.871), strict=True
        ):
            front_mm = half_mm * math.sin(first * turns)
            reach_mm = 0.95 * slope * self.distance_mm
            # within both limits on a smooth path: no beam changes direction from one exposure to the next
            rear_mm = half_mm * math.tanh((front_mm + reach_mm * math.sin(second * turns + 1.0)) / half_mm)
            aside_mm = reach_mm * math.tanh((rear_mm - front_mm) / reach_mm)
            places.append((front_mm, aside_mm / self.distance_mm))
        (x_mm, slope_x), (y_mm, slope_y) = places
        return BeamPose(x_mm, y_mm, slope_x, slope_y)

    def truth(self, t_ns: int) -> FloatArray:
        """True x mm, y mm, yaw °, pitch °."""
        return place_of(self.unit.truth(t_ns))

    def frame(self, camera: str, sequence: int, t_ns: int, rng: np.random.Generator) -> Frame:
        """Frame with the light, spot size and power of its time."""
        imager, t_s = self.unit.imagers[camera], t_ns * 1e-9
        electrons = imager.view.background_e(self.exposure_ms, self.lives.lux_of(t_s), False)
        spots = [self._drifted(spot, t_s) for spot in self.unit.spots(camera, t_ns)]
        region, beam_e = imager.view.beam_e(spots, self.exposure_ms)
        electrons[region] += beam_e
        noise = self.noise.picture(electrons.shape, rng)
        pixels = noisy_image(mean_image(electrons, self.sensor), noise, self.sensor.bits)
        pixels.flags.writeable = False
        return Frame(camera, sequence, t_ns, pixels, self.sensor.bits, exposure_ms=1.0)

    def _drifted(self, spot: Footprint, t_s: float) -> Footprint:
        """Spot with the drift of its size and the laser's power over the day, as with temperature."""
        day = math.sin(2.0 * math.pi * t_s / 86_400.0)
        scale = 1.0 + self.lives.size_drift * day
        power = 1.0 + self.lives.power_drift * math.cos(2.0 * math.pi * t_s / 50_000.0)
        xx, xy, yy = (term / scale**2 for term in spot.form)
        return replace(spot, form=(xx, xy, yy), peak_mw_per_mm2=spot.peak_mw_per_mm2 * power / scale**2)


_unit = cache(lambda name: _GoodUnit(GOOD[name]))


def measure_hour(name: str, hour: int, step_s: float, seed: int) -> Count:
    """Measure one hour of a unit's operation through one chain."""
    good = _unit(name)
    rng = np.random.default_rng([seed, hour, *name.encode()])
    count = Count()
    chain = chain_of(good.calibration, Measuring(window=WINDOW, every=1))
    for step in range(max(1, round(HOUR_S / step_s))):
        start_ns = round((hour * HOUR_S + step * step_s) * 1e9) // PERIOD_NS * PERIOD_NS + PERIOD_NS
        _measure_burst(good, chain, start_ns, rng, count)
    return count


def _measured(chain: MeasuringChain, frame: Frame, count: Count) -> Iterator[Measurement]:
    """Measurement that a frame completes; located and refused spots are added to ``count``."""
    for pair in chain.pairer.add(frame.camera, frame.sequence, frame.t_ns, frame):
        located = pair.converted(chain.located)
        for one in located.all_items:
            count.frames += one.found is not None
            if isinstance(one.found, NoSpot):
                count.frames_refused[f"{one.camera}_{one.found.reason}"] += 1
        if (measurement := chain.add(located)) is not None:
            yield measurement


def _measure_burst(
    good: _GoodUnit, chain: MeasuringChain, start_ns: int, rng: np.random.Generator, count: Count
) -> None:
    truth = []
    for k in range(BURST):
        t_ns = start_ns + k * PERIOD_NS
        truth.append(good.truth(t_ns))
        for camera in CAMERAS:
            for measurement in _measured(chain, good.frame(camera, t_ns // PERIOD_NS, t_ns, rng), count):
                if k < WINDOW - 1:  # the window is still filling
                    continue
                times_ns = t_ns + PERIOD_NS * np.arange(1.0 - WINDOW, 1.0)
                true = truth_of(measurement, np.array(truth[-WINDOW:]), times_ns)
                judged = judge(measurement, true)
                count.measurements += 1
                count.warned.update(judged.warnings)
                count.invalid.update([", ".join(judged.reasons)] if judged.reasons else [])
                count.wrong += judged.verdict is Verdict.WRONG
                if measurement.valid:
                    values, sigma = arrays(measurement)
                    ratio = (values - true) / sigma
                    count.valid += 1
                    count.squares = [a + float(b) ** 2 for a, b in zip(count.squares, ratio, strict=True)]
                    count.largest_sigmas = max(count.largest_sigmas, float(np.abs(ratio).max()))


def run_good(
    hours: int, step_s: float, seed: int, processes: int, kept: Path, progress: Callable[[int, int], None]
) -> dict[str, Count]:
    """Sums by unit; hours with a result of exactly this code in ``kept`` are taken from there."""
    for circumstances in GOOD.values():
        calibrated(circumstances.unit)
    code = hash_of(ROOT / part for part in ("altd", "hw_sim", "benchmarks/campaign"))
    folder = kept / f"good-{code}-{step_s:g}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [(hour, name) for hour in range(hours) for name in GOOD]
    open_ = [(hour, name) for hour, name in wanted if not (folder / f"{name}-{hour}.json").exists()]
    progress(len(wanted) - len(open_), len(wanted))
    with workers(processes) as pool:
        running = {pool.submit(measure_hour, name, hour, step_s, seed): (name, hour) for hour, name in open_}
        for done, future in enumerate(as_completed(running), start=len(wanted) - len(open_) + 1):
            name, hour = running[future]
            (folder / f"{name}-{hour}.json").write_text(future.result().as_json())
            progress(done, len(wanted))
    sums = {name: Count() for name in GOOD}
    for hour, name in wanted:
        sums[name].merge(Count.of_json((folder / f"{name}-{hour}.json").read_text()))
    return sums


_TABLE = Columns(
    *("unit:<9", "frames:>9", "refused:>9", "measured:>10", "invalid:>9", "warned:>8", "wrong:>7"),
    *("rms(error/sigma) x y yaw pitch:>33", "largest:>9.1f"),
)


def lines(sums: Mapping[str, Count], hours: int, step_s: float) -> Iterator[str]:
    """Lines of the table."""
    yield (
        f"{hours} h of {len(sums)} units; every {step_s:g} s of it {BURST} exposures at 20 a second, "
        f"window {WINDOW}: {BURST - WINDOW + 1} measurements"
    )
    yield _TABLE.head
    total = Count()
    for name, count in sums.items():
        alarms = (count.invalid.total(), count.warned.total(), count.wrong)
        rms = " ".join(f"{value:.2f}" for value in count.rms)
        refused = count.frames_refused.total()
        yield _TABLE.row(name, count.frames, refused, count.measurements, *alarms, rms, count.largest_sigmas)
        total.merge(count)
    alarms_of_all = total.invalid.total() + total.warned.total()
    yield (
        f"{total.measurements} measurements: {total.invalid.total()} invalid, {total.warned.total()} warned: "
        f"{1e5 * alarms_of_all / max(total.measurements, 1):.1f} false alarms in 100,000"
    )
    median = statistics.median(value for count in sums.values() for value in count.rms)
    yield f"rms(error/sigma), median of units and quantities: {median:.2f}"
    for what, counter in (
        ("invalid", total.invalid),
        ("warned", total.warned),
        ("frames refused", total.frames_refused),
    ):
        words = ", ".join(f"{reason} {count}" for reason, count in counter.most_common())
        yield f"{what}: {words or 'none'}"
