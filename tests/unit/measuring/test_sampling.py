"""Even or uneven: the fact that decides whether a stated vibration is in sigma."""

from dataclasses import replace

import numpy as np
import pytest
from support.located import SPOT, located, paired
from support.recordings import place_px

from altd.config import Measuring
from altd.devices.trigger_times import TriggerTimes
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.averaging import FrameSetWindow
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.sampling import Sampling, SamplingCheck, ScatterMemory
from altd.measuring.spot_locator import Located
from altd.reasons import Reason
from altd.records import FrameSet, MeanSpots, Spot

PERIOD_NS = 50_000_000


def triggered(shortest_ns: int = 0, count: int = 400, since_ns: int = 0) -> list[int]:
    triggers, times_ns = TriggerTimes(PERIOD_NS, shortest_ns), [since_ns]
    while len(times_ns) < count:
        times_ns.append(triggers.after(times_ns[-1]))
    return times_ns


def of_grid(jitter_periods: float, count: int = 400, lost_every: int = 1000) -> list[int]:
    rng = np.random.default_rng(count)
    numbers = [number for number in range(count) if number % lost_every != lost_every - 1]
    return [round((n + jitter_periods * rng.uniform()) * PERIOD_NS) for n in numbers]


def spot_of(target: str, number: int, t_ns: int, x_mm: float = 5.0) -> Located:
    u_px, v_px = place_px(target, x_mm, 3.0)
    spot = replace(SPOT, u_px=u_px, v_px=v_px)
    return replace(located(target, number, t_ns), spot=spot, found=spot)


def errors_and_sigmas_mm(
    calibration: Calibration, times_ns: list[int], amplitude_mm: float, hertz: float, phase: float
) -> list[tuple[float, float] | None]:
    """Of x, of a beam that vibrates about 5 mm; None: warming up."""
    rng, found = np.random.default_rng(4), []
    views = (View("front", "front"), View("rear", "rear"))
    chain = MeasuringChain(views, calibration, Measuring(), BeamInstrument(calibration, Measuring()))
    for number, t_ns in enumerate(times_ns):
        moved_mm = amplitude_mm * np.sin(2 * np.pi * hertz * t_ns * 1e-9 + phase)
        x_mm = 5.0 + moved_mm + rng.normal(0, 0.003, 2)
        one = chain.add(
            paired(spot_of("front", number, t_ns, x_mm[0]), spot_of("rear", number, t_ns, x_mm[1]))
        )
        assert one is not None
        assert one.valid or [fault.reason for fault in one.status] == [Reason.WARMING_UP]
        x = one.known("x_mm")
        found.append((x.value - 5.0, x.sigma) if x is not None and x.sigma is not None else None)
    return found


@pytest.mark.parametrize(
    ("times_ns", "sampling"),
    [
        pytest.param(of_grid(0.0), Sampling.EVEN, id="a crystal"),
        pytest.param(of_grid(0.1, lost_every=13), Sampling.EVEN, id="jitter of 5 ms, frames lost"),
        pytest.param(triggered(), Sampling.UNEVEN, id="software triggers"),
        pytest.param(triggered(45_000_000), Sampling.EVEN, id="of cameras that take 45 ms"),
        pytest.param(of_grid(0.0, count=99), None, id="not known yet"),
    ],
)
def test_the_times_of_the_exposures_show_it(times_ns: list[int], sampling: Sampling | None) -> None:
    check = SamplingCheck()
    found = []
    for t_ns in times_ns:
        check.add(t_ns)
        found.append(check.found)
    assert set(found[100:]) <= {sampling}
    assert check.found is sampling


@pytest.mark.parametrize("hertz", [20.0, 29.0, 40.0])
def test_sigma_covers_a_vibration_although_phases_are_close_together_by_chance(hertz: float) -> None:
    """Of 1 px, in 300 windows; the window's own scatter is up to ten times too small."""
    rng, memory = np.random.default_rng(3), ScatterMemory()
    window = FrameSetWindow(("front",), 20, 20, memory)
    sampling, in_sigmas, least = SamplingCheck(), [], []
    for number, t_ns in enumerate(triggered(count=6000)):
        sampling.add(t_ns)
        u_px = float(np.sin(2 * np.pi * hertz * t_ns * 1e-9) + rng.normal(0, 0.04))
        mean = window.add(FrameSet(number, t_ns, {"front": Spot(u_px, 0.0, 0.04, 40.0, 150.0)}))
        if isinstance(mean, MeanSpots):
            widened = memory.widened(mean, sampling.excess(mean.frames))
            if widened is None:
                assert number < 20
                continue
            least.append(np.linalg.eigvalsh(widened.covariance_px2 - mean.covariance_px2).min())
            in_sigmas.append(mean.px[0, 0] / np.sqrt(widened.covariance_px2[0, 0]))
    assert 0.8 < np.sqrt(np.square(in_sigmas).mean()) < 1.25
    assert np.abs(in_sigmas).max() < 5.0
    assert min(least) > -1e-12


@pytest.mark.parametrize(
    ("since_ns", "hertz", "phase"),
    [
        (1_842_326_008_057, 40, 3.665),
        (1_772_407_456_855, 40, 4.712),
        (1_941_820_754_008, 40, 2.094),
        (1_694_328_134_039, 20, 2.094),
        (24_859_639_745, 40, 3.142),
        (417_447_966_733, 40, 3.142),
        (210_275_614_148, 60, 2.094),
    ],
)
def test_sigma_covers_a_vibration_from_the_first_value_on(
    calibration: Calibration, since_ns: int, hertz: float, phase: float
) -> None:
    """Of 0.3 mm: of the worst of 5,700 starts, up to 20 times the first windows' own scatter."""
    times_ns = triggered(count=61, since_ns=since_ns)[1:]
    vibrating = errors_and_sigmas_mm(calibration, times_ns, 0.3, hertz, phase)
    assert max(abs(one[0]) / one[1] for one in vibrating if one) < 6.0
    assert all(vibrating[20:])
    at_rest = errors_and_sigmas_mm(calibration, times_ns, 0.0, hertz, phase)
    even = errors_and_sigmas_mm(calibration, of_grid(0.0, 60), 0.0, hertz, phase)
    assert all(even[9:])
    pairs = [(one[1], other[1]) for one, other in zip(at_rest, even, strict=True) if one and other]
    assert max(uneven / usual for uneven, usual in pairs) < 1.3


@pytest.mark.parametrize(
    ("times_ns", "apart_ns", "is_even"),
    [
        (of_grid(0.0, 120), 0, True),
        (of_grid(0.0, 120), 2_000_000, True),
        (triggered(count=120), 0, False),
    ],
)
def test_a_stated_vibration_is_in_sigma_until_the_exposures_are_known_to_be_uneven(
    calibration: Calibration, times_ns: list[int], apart_ns: int, is_even: bool
) -> None:
    """Of two cameras that expose apart, at 130 Hz: the spots' displacements have another phase."""
    opposite = np.sin(np.pi * 130.0 * np.hypot(apart_ns * 1e-9, 0.5e-3))
    turning = np.rad2deg(2 * 0.3 * opposite / 280.0) ** 2 / 2
    first, last = [], []
    for stated in ({}, {"vibration_mm": 0.3}, {"vibration_mrad": 0.2}):
        measuring = Measuring.model_validate({"pair_by": "time", **stated})
        views = (View("front", "front"), View("rear", "rear"))
        chain = MeasuringChain(views, calibration, measuring, BeamInstrument(calibration, measuring))
        valid = []
        for number, t_ns in enumerate(times_ns):
            one = chain.add(paired(spot_of("front", number, t_ns), spot_of("rear", number, t_ns + apart_ns)))
            if one is not None and one.valid:
                valid.append([one.sigma(key) for key in ("x_mm", "y_mm", "yaw_deg", "pitch_deg")])
        assert one is not None
        assert one.valid, one.status
        assert chain.figures()["sampling"] == ("even" if is_even else "uneven")
        first.append(valid[0])
        last.append(valid[-1])
    for sigmas, is_stated in ((first, True), (last, is_even)):
        alone, moved, turned = np.square(np.array(sigmas))
        yaw = np.rad2deg(0.2e-3) ** 2 / 2
        wanted = [0.3**2 / 2] * 2 + [turning] * 2 if is_stated else [0] * 4
        assert moved - alone == pytest.approx(wanted, rel=1e-4, abs=1e-9)
        wanted = [0, 0, yaw, yaw] if is_stated else [0] * 4
        assert turned - alone == pytest.approx(wanted, rel=0.02, abs=1e-12)
