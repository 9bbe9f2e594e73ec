"""The frame LEDs of a scan, and the self-check made from its first LED pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from altd.acquisition.self_check.exposing import CheckFrames
from altd.acquisition.self_check.judging import CheckJudge
from altd.measuring.calibration import Calibration
from altd.measuring.pairing import Pair
from altd.ports import Camera, Lamps
from altd.records import Frame
from altd.selfcheck.records import SelfCheck, unknown


@dataclass(frozen=True, slots=True)
class KnownUnit:
    """Previous calibration of the unit, the reference for LED pairs. ``targets`` is by camera."""

    calibration: Calibration
    judge: CheckJudge
    targets: Mapping[str, str]

    def check(self, pairs: Sequence[Pair[Frame]], cameras: Sequence[Camera]) -> SelfCheck:
        """Judge the pairs of one check, all exposures complete; takes 10 to 50 ms per target.

        The verdict is unknown if a camera is not the calibrated one: its drift has no reference.
        """
        for camera in cameras:
            target = self.calibration.target(self.targets[camera.name])
            if target is None or camera.identity is None:
                continue
            if difference := camera.identity.difference_from(target.camera):
                return unknown(f"{target.name} was calibrated with another camera: {difference}")
        frames = [pair.items for pair in pairs]
        dark, lit = (
            {name: tuple(of[name] for of in frames if of[name].leds_on is on) for name in self.targets}
            for on in (False, True)
        )
        return self.judge.judge(CheckFrames(dark, lit, dict.fromkeys(dark, ())), {}, None)


@dataclass(frozen=True, slots=True)
class ScanLeds:
    """The frame LEDs, and the previous calibration, or the reason why there is none."""

    lamps: Lamps
    known: KnownUnit | str
