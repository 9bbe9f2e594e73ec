"""Derives the verdict of a check from its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from altd.acquisition.self_check.exposing import CheckFrames
from altd.config import Installation, SelfCheckSettings
from altd.measuring.calibration import Calibration
from altd.measuring.chain import View
from altd.records import Value
from altd.selfcheck.lights import findings
from altd.selfcheck.records import DriftLimits, LedView, SelfCheck, Verdict, unknown
from altd.selfcheck.verdict import judge

SpotPx = tuple[float, float]


def limits_of(settings: SelfCheckSettings) -> DriftLimits:
    """Return the limits in the settings."""
    return DriftLimits(
        suspect_mm=settings.suspect_mm,
        suspect_deg=settings.suspect_deg,
        bad_mm=settings.bad_mm,
        bad_deg=settings.bad_deg,
        compensate_mm=settings.compensate_mm,
    )


class CheckJudge:
    """Judges the frames of ``views``' cameras; keeps no state between checks.

    The effect of a drift on a measurement has the signs of the installation.
    """

    def __init__(
        self, views: Sequence[View], calibration: Calibration, limits: DriftLimits, installation: Installation
    ) -> None:
        self._views = views
        self._calibration = calibration
        self._limits = limits
        self._installation = installation

    def judge(self, frames: CheckFrames, at: Mapping[str, SpotPx], previous: Verdict | None) -> SelfCheck:
        """Return the verdict; ``at`` is the position of the spot by target, ``previous`` the last verdict.

        A target with disturbed frames is skipped; the other targets count.
        """
        notes: list[str] = []
        spoilt: list[str] = []
        seen: dict[str, LedView] = {}
        for view in self._views:
            before, lit, after = (of[view.camera] for of in (frames.before, frames.lit, frames.after))
            target = self._calibration.target(view.target)
            assert target is not None  # noqa: S101  the daemon was refused without it
            found = findings(before, lit, after, target.leds_px)
            for finding in found:
                (spoilt if finding.spoils else notes).append(f"{view.target}: {finding.sentence}")
            if not any(finding.spoils for finding in found):
                seen[view.target] = LedView(lit, (*before, *after))
        check = judge(
            seen,
            self._calibration,
            at,
            self._limits,
            previous=previous,
            reference_plane_mm=self._installation.reference_plane_mm,
        )
        effects = _installed(check.effects, self._installation)
        check = replace(check, effects=effects, notes=tuple(notes))
        if not spoilt:
            return check
        if check.verdict is Verdict.UNKNOWN:
            return replace(unknown(*spoilt), notes=check.notes)
        skipped = {target.name for target in self._calibration.targets} - seen.keys()
        doubts = (part for part in check.parts if part.verdict is not Verdict.GOOD)
        reasons = tuple(part.reason for part in doubts if part.of not in skipped)
        return replace(check, reasons=(*reasons, *spoilt))


def _installed(effects: Mapping[str, Value], installation: Installation) -> Mapping[str, Value]:
    """Return effects in the unit frame with the signs of the controller, whose axes may be reversed."""
    signs = installation.signs
    return {key: replace(effect, value=signs[key] * effect.value) for key, effect in effects.items()}
