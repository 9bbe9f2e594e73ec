"""Compiled code and numpy find the same: numpy, which is also tested alone, is the truth here."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.foreign import need
from support.frames import Blob, light
from support.photographs import SIZE, dots, photographed

from altd.records import FloatArray, Frame, NoSpot, Spot
from altd.vision import blocks, fit, kernel, misfit, profile
from altd.vision.blocks import Blocks
from altd.vision.flat import Flat
from altd.vision.localise import fitted_profile, locate
from altd.vision.misfit import FitResiduals, Misfit
from altd.vision.settings import SpotReference, SpotSettings

CLOSE = 1e-9
"""Of the value. Sums in another order differ by 1e-13; a fit carries on what is left of its last step."""


@pytest.fixture(autouse=True)
def compiled() -> None:
    need(kernel.is_compiled(), f"altd runs on {kernel.description}")


def frames() -> Iterator[tuple[Frame, Flat | None]]:
    """Spots on plain and printed targets: small, cut by the edge, clipped, dusty, doubled, dim."""
    rng = np.random.default_rng(7)
    printed = dots()
    flat = Flat.from_response(printed, "recording")
    blobs = [
        *(Blob(*rng.uniform(70, 100, 2), peak=peak) for peak in (20, 60, 120, 200, 262)),
        *(Blob(84.3, 80.7, diameter) for diameter in (8.0, 16.0, 28.0, 64.0)),
        *(Blob(u, v) for u, v in ((3.0, 80.0), (-6.0, 81.0), (84.0, 163.0), (165.0, 165.0))),
        Blob(84, 80, peak=3),
        Blob(84, 80, peak=0.5),
    ]
    for blob in blobs:
        spot = light(blob, width=SIZE, height=SIZE)
        yield photographed(spot, rng), None
        yield photographed(printed * spot, rng), flat
    spot = light(Blob(84.3, 80.7), width=SIZE, height=SIZE)
    yield photographed(printed * (spot + light(Blob(99, 90, peak=25), width=SIZE, height=SIZE)), rng), flat
    dusty = printed * spot
    dusty[76:83, 70:78] *= 0.3
    yield photographed(dusty, rng), flat
    radius_px = np.hypot(*np.mgrid[-80 : SIZE - 80, -84 : SIZE - 84])
    black = Flat.from_response(np.where(radius_px < 25, 0.0, 1.0), "recording")
    yield photographed(spot, rng), black


def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Blocks, fit.State, float, int]]:
    """The input of these frames' fits."""
    taken: list[tuple[Blocks, fit.State, float, int]] = []

    def solve(
        data: Blocks, state: fit.State, rise: float, order_free_iteration: int = fit.ORDER_FREE_ITERATION
    ) -> fit.FitState | None:
        taken.append((data, state, rise, order_free_iteration))
        return fit.solve_by_numpy(data, state, rise, order_free_iteration)

    with monkeypatch.context() as patched:
        patched.setattr(profile, "solve", solve)
        for frame, flat in frames():
            locate(frame, flat=flat)
    assert len(taken) >= 30
    return taken


def is_close(one: object, other: object, scale: float = 0.0) -> bool:
    return bool(np.allclose(one, other, rtol=CLOSE, atol=CLOSE * scale))  # type: ignore[arg-type]


def assert_same_fit(one: fit.FitState | None, other: fit.FitState | None) -> None:
    assert (one is None) is (other is None)
    if one is None or other is None:
        return
    assert is_close(one.state, other.state, scale=1.0)
    assert one.rows.shape == other.rows.shape
    for name, found, values in (
        ("centre_variance", one.centre_variance, other.centre_variance),
        ("contrast2", one.contrast2, other.contrast2),
        *((f"row {number}", one.rows[number], row) for number, row in enumerate(other.rows)),
    ):
        assert is_close(found, values, scale=float(np.abs(values).max())), name


def test_fits_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    given = calls(monkeypatch)
    for data, state, rise, order_free_iteration in given:
        known = fit.solve_by_numpy(data, state, rise, order_free_iteration)
        assert_same_fit(fit.solve(data, state, rise, order_free_iteration), known)
    assert any(not data.has_moments for data, *_ in given)
    assert any(data.has_moments for data, *_ in given)


@pytest.mark.parametrize(
    ("rows", "change"),
    [
        (blocks.LIGHT, lambda values: values * np.nan),
        (blocks.LIGHT, lambda values: values + np.inf),
        (blocks.LIGHT, lambda values: values * 0),
        (blocks.LIGHT, lambda values: -values),
        (blocks.LIGHT, lambda values: np.random.default_rng(1).normal(0, 1, values.size)),
        (blocks.LIGHT, lambda values: values * 1e30),
        (blocks.MONOMIALS, lambda values: values * 0),
        ([blocks.F1, blocks.F2], lambda values: values * 0),
        ([blocks.READ_NOISE, blocks.SHOT_NOISE], lambda values: values * 0),
        (blocks.SPOT_TEXTURE, lambda values: values * 0),
    ],
)
def test_spoilt_blocks_are_fitted_by_both_or_by_neither(
    monkeypatch: pytest.MonkeyPatch, rows: int | slice | list[int], change: Callable[[FloatArray], FloatArray]
) -> None:
    for data, state, rise, order_free_iteration in calls(monkeypatch)[:12]:
        spoilt = data.rows.copy()
        spoilt[rows] = change(spoilt[rows])
        given = replace(data, rows=spoilt)
        with np.errstate(all="ignore"):
            known = fit.solve_by_numpy(given, state, rise, order_free_iteration)
        found = fit.solve(given, state, rise, order_free_iteration)
        assert (known is None) is (found is None)


def test_misfits_are_the_same() -> None:
    compared = 0
    for frame, flat in frames():
        fitted = fitted_profile(frame, SpotSettings(), flat)
        if fitted is None:
            continue
        for usual_contrast in (None, 0.02, 0.1):
            for kept in (slice(None), slice(None, None, 2), slice(0, 5), slice(0, 0)):
                residuals = some_of(fitted.residuals, kept)
                compared += assert_same_misfit(residuals, usual_contrast)
    assert compared > 40


def some_of(residuals: FitResiduals, kept: slice) -> FitResiduals:
    given, solution = residuals.blocks, residuals.solution
    return replace(
        residuals,
        blocks=replace(given, rows=given.rows[:, kept]),
        solution=replace(solution, rows=solution.rows[:, kept]),
    )


def assert_same_misfit(residuals: FitResiduals, usual_contrast: float | None) -> bool:
    found = misfit.misfit_of(residuals, usual_contrast)
    known = by_numpy(residuals, usual_contrast)
    assert (found is None) is (known is None)
    if found is None or known is None:
        return False
    for name in ("chi2", "degrees_of_freedom", "centre_covariance_px2", "pattern_px"):
        assert is_close(getattr(found, name), getattr(known, name), scale=1e-3), name
    used = found.scores.any(axis=0)
    assert is_close(found.scores[:, used], known.scores, scale=1e-3)
    return True


def by_numpy(residuals: FitResiduals, usual_contrast: float | None) -> Misfit | None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(kernel, "_library", None)
        return misfit.misfit_of(residuals, usual_contrast)


def test_arrays_of_another_layout_give_the_same_and_of_another_size_are_refused() -> None:
    """Compiled code reads doubles, row after row, and does not know where an array ends."""
    frame, flat = next(frames())
    fitted = fitted_profile(frame, SpotSettings(), flat)
    residuals = fitted.residuals
    given, solution = residuals.blocks, residuals.solution
    turned = replace(
        residuals,
        blocks=replace(given, rows=np.asfortranarray(given.rows)),
        solution=replace(solution, rows=np.repeat(solution.rows, 2, axis=1)[:, ::2]),
    )
    assert assert_same_misfit(turned, None)
    whole_numbers = [round(solution.state[fit.PEAK]) + 1, 0, 0, 1, 0, 1, 0, 0, 0, 1]
    assert_same_misfit(replace(residuals, solution=replace(solution, state=whole_numbers)), None)
    for shorter in (replace(given, rows=given.rows[:, :-1]), replace(given, rows=given.rows[:, :0])):
        with pytest.raises(ValueError, match="blocks, but a fit of"):
            misfit.misfit_of(replace(residuals, blocks=shorter))


def test_spots_and_reasons_are_the_same() -> None:
    reference = SpotReference(grain=0.05, misfit_ratio=1.0, pattern_px=0.02, noise_px=0.005, shape=None)
    reasons = set()
    for frame, flat in frames():
        for usual in (None, reference):
            found = locate(frame, flat=flat, reference=usual)
            with pytest.MonkeyPatch.context() as patched:
                patched.setattr(kernel, "_library", None)
                known = locate(frame, flat=flat, reference=usual)
            if isinstance(found, Spot) and isinstance(known, Spot):
                assert (found.u_px, found.v_px) == pytest.approx((known.u_px, known.v_px), abs=1e-9)
                expected = known.sigma_px, known.excess_px
                assert (found.sigma_px, found.excess_px) == pytest.approx(expected, rel=1e-6)
            else:
                assert found == known
                assert isinstance(found, NoSpot)
                reasons.add(found.reason)
    assert len(reasons) >= 3


def test_without_the_library_it_says_so_and_measures(tmp_path: Path) -> None:
    """In a process of its own, which finds none, or one that is none."""
    for content, said in ((None, "numpy: altd was built without a C compiler"), (b"none", "numpy: ")):
        file = tmp_path / "libkernel.so"
        if content is not None:
            file.write_bytes(content)
        program = (
            "import numpy, pathlib\n"
            f"pathlib.Path.with_name = lambda path, name: pathlib.Path({str(file)!r})\n"
            "from altd.vision import kernel\n"
            "print(kernel.is_compiled(), kernel.description)\n"
        )
        command = [sys.executable, "-c", program]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert out.startswith(f"False {said}"), out
