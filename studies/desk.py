"""A unit of two webcams and tracing paper: calibrated from a screen, beams at rest and in motion."""

import math
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from altd.app.replay import replay_of
from altd.recording.reader import open_recording
from altd.records import FloatArray
from hw_sim.beam import BeamPose
from hw_sim.desk import BLUR_PX, LASER, Beam, Desk, Screen
from hw_sim.unit import CAMERAS
from hw_sim.webcam import Webcam
from studies.bench import QUANTITIES, rms, run_altd
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result, Row

TITLE = "A unit of two webcams, calibrated from a screen"
QUESTION = "How good is a desk unit with ordinary webcams, and which mistakes does it detect?"

BEAMS, EXPOSURES = 40, 5
SPEED_MM_PER_S = 5.0
ROW_TIME_US = 65.0
"""480 rows in 31 ms, nearly the period of 30 fps."""
WRONG_SIGMAS = 5.0

SCREEN = Screen(stated={"beam_mm": 5.5})
"""``stated`` goes into the plate's header. This screen lies exactly, and its pitch is exact."""
NOT_STATED: dict[str, object] = {}
STATED = {
    "pitch_sigma_mm": 0.01 * SCREEN.pitch_mm,
    "placed": {"sigma_mm": 0.0, "sigma_deg": 2.0, "camera_mm": 200.0},
}
"""1 % of the scale and 2° of tilt, one sigma each."""
USUAL = Webcam(gamma=2.2)

COLUMNS = (
    Column("x, y, rms mm", judged=False),
    Column("yaw, pitch, rms °", judged=False),
    Column("error/sigma, rms", 2, judged=False),
    Column("largest error/sigma", 1, judged=False),
    Column("valid, %", 0, judged=False),
)


@dataclass(frozen=True, slots=True)
class Case:
    """A unit, its screen and the speed of the beams."""

    name: str
    webcam: Webcam = USUAL
    speed_mm_per_s: float = 0.0
    screen: Screen = SCREEN
    blur_px: float = BLUR_PX
    knows_row_time: bool = True

    @property
    def desk(self) -> Desk:
        """Its unit."""
        return Desk(self.webcam, blur_px=self.blur_px, states_row_time=self.knows_row_time)


ROLLING = replace(USUAL, row_time_us=ROW_TIME_US)
CASES = (
    Case("YUYV, gamma 1, at rest", Webcam()),
    Case("YUYV, at rest"),
    Case("YUYV, 5 mm/s", USUAL, SPEED_MM_PER_S),
    Case("rolling shutter, 5 mm/s", ROLLING, SPEED_MM_PER_S),
    Case("rolling shutter, not stated, 5 mm/s", ROLLING, SPEED_MM_PER_S, knows_row_time=False),
    *(Case(f"JPEG {quality}, at rest", replace(USUAL, jpeg_quality=quality)) for quality in (95, 75, 50)),
    Case("JPEG 95, rolling shutter, 5 mm/s", replace(ROLLING, jpeg_quality=95), SPEED_MM_PER_S),
    Case("JPEG 75, gamma 1, at rest", Webcam(jpeg_quality=75)),
    Case("gain hunts by 20 %", replace(USUAL, hunting=0.2)),
    Case("defocused, 3 px", blur_px=3.0),
    Case("beam of 12 mm stated", screen=replace(SCREEN, stated={})),
    *(
        Case(
            f"{mistake}, {'stated' if of else 'not stated'}",
            screen=replace(wrong, stated={**SCREEN.stated, **of}),
        )
        for mistake, wrong in (
            ("scale wrong by 1 %", replace(SCREEN, scale_error=0.01)),
            ("screen tilted by 2°", replace(SCREEN, tilt_deg=2.0)),
        )
        for of in (NOT_STATED, STATED)
    ),
)


@dataclass(slots=True)
class Trial:
    """Calibrations and recordings of a unit in a folder; those that several cases share are made once."""

    folder: Path
    calibrations: dict[tuple[object, ...], Path] = field(default_factory=dict)
    recordings: dict[tuple[object, ...], tuple[Path, list[Beam]]] = field(default_factory=dict)

    def errors(self, case: Case, beams: int = BEAMS) -> tuple[FloatArray, FloatArray]:
        """Errors and error/sigma (n, 4) of x, y, yaw and pitch of the valid measurements of the beams."""
        path, truth = self._recorded(case, beams)
        replay = replay_of(open_recording(path), self._calibrated(case), EXPOSURES, EXPOSURES)
        live = replay.measuring.model_copy(update={"pair_by": "time"})  # as for cameras that run freely
        errors, ratios = [], []
        for measurement in replace(replay, measuring=live).measurements():
            if measurement.valid:
                true = truth[measurement.sequence // EXPOSURES].at(measurement.t_ns * 1e-9)
                off = [measurement.values[key].value - _true(true, key) for key in QUANTITIES]
                errors.append(off)
                sigmas = [measurement.values[key].sigma or math.nan for key in QUANTITIES]
                ratios.append(np.array(off) / sigmas)
        return np.array(errors).reshape(-1, 4), np.array(ratios).reshape(-1, 4)

    def _calibrated(self, case: Case) -> Path:
        """The calibration from a plate at each target; its cameras are at rest, so their shutter is equal."""
        webcam = replace(case.webcam, row_time_us=0.0)
        key = webcam, case.blur_px, repr(case.screen)
        if key not in self.calibrations:
            folder = self.folder / f"calibration-{len(self.calibrations)}"
            for name in CAMERAS:
                replace(case.desk, webcam=webcam).record_plate(folder / name, name, case.screen)
            path = folder / "calibration.json"
            run_altd("calibrate", *(folder / name for name in CAMERAS), "-o", path)
            for name in CAMERAS:
                shutil.rmtree(folder / name)
            self.calibrations[key] = path
        return self.calibrations[key]

    def _recorded(self, case: Case, beams: int) -> tuple[Path, list[Beam]]:
        key = case.desk, case.speed_mm_per_s, beams
        if key not in self.recordings:
            for path, _ in self.recordings.values():
                shutil.rmtree(path, ignore_errors=True)
            self.recordings.clear()
            truth = case.desk.beams(beams, EXPOSURES, case.speed_mm_per_s)
            path = self.folder / "beams"
            case.desk.record_beams(path, truth, EXPOSURES)
            self.recordings[key] = path, truth
        return self.recordings[key]


def _true(pose: BeamPose, key: str) -> float:
    value: float = getattr(pose, key)
    return value


def row_of(name: str, errors: FloatArray, ratios: FloatArray, beams: int = BEAMS) -> Row:
    """The figures of a case; none but the share if nothing is valid."""
    if not len(errors):
        return Row(name, (None, None, None, None, 0.0))
    valid = 100.0 * len(errors) / beams
    figures = (rms(errors[:, :2]), rms(errors[:, 2:]), rms(ratios), float(np.abs(ratios).max()), valid)
    return Row(name, figures)


def run(progress: Progress) -> Result:
    """All cases of one unit; those of the same webcam and motion see the same frames."""
    rows: dict[str, Row] = {}
    order = sorted(CASES, key=lambda case: case.desk == CASES[1].desk and not case.speed_mm_per_s)
    with TemporaryDirectory(prefix="hw_sim-study-") as folder:
        trial = Trial(Path(folder))
        for case in order:
            progress(case.name)
            rows[case.name] = row_of(case.name, *trial.errors(case))
    lines = [rows[case.name] for case in CASES]
    figure, axes = panels(1, 2)
    places = np.arange(len(lines))[::-1]
    for axis, column, limit, label in (
        (axes[0], 0, 0.05, "x and y, rms mm"),
        (axes[1], 2, 1.25, "error/sigma, rms"),
    ):
        axis.barh(places, [line.ours[column] or 0.0 for line in lines], color=OURS)
        axis.axvline(limit, color=THESIS)
        axis.set(xlabel=label)
        axis.set_yticks(
            places, [line.name for line in lines] if column == 0 else [""] * len(lines), fontsize=6
        )
    best, moving, stated, unknown = (line.ours for line in lines[1:5])
    wrong = [line.name for line in lines if (line.ours[3] or 0.0) > WRONG_SIGMAS]
    return Result(
        of="unit",
        thesis_source="its units have industrial cameras and are calibrated with a stage",
        differs="cameras, targets and calibration are those of a unit for a desk",
        columns=COLUMNS,
        rows=tuple(lines),
        headline=(
            f"Two simulated webcams with YUYV, calibrated from a screen, measure beams at rest to "
            f"{best[0]:.3f} mm and {best[1]:.4f}°; errors of more than 5 sigma are valid in: "
            f"{', '.join(wrong) or 'none'}."
        ),
        text=f"""
640 × 480 pixels of 8 bits see 100 mm of plain tracing paper in height, from 200 mm and tilted by 15° to 20°;
the papers are 280 mm apart. A red laser of {LASER.diameters_mm[0]:g} × {LASER.diameters_mm[1]:g} mm fills a
quarter of the pixels of a colour sensor, whose luminance is measured. Pictures have gamma 2.2 where nothing
else is said. The screen shows {SCREEN.columns} × {SCREEN.rows} discs, {SCREEN.pitch_mm:g} mm apart, with its
pixels of {SCREEN.pixel_mm:g} mm. {BEAMS} beams lie within ±52 × ±37 mm on both papers; a value is the mean of
{EXPOSURES} exposures at 30 a second. The cameras run freely, 7 ms apart.

**Motion.** Sigma of x and y contains a possible lag of all cameras by a frame, which nothing shows: 0.05 mm
at {SPEED_MM_PER_S:g} mm/s. So error/sigma is small there. With a rolling shutter of {ROW_TIME_US:g} µs a row
yaw and pitch err by {unknown[1] or 0.0:.4f}° if `row_time_us` is not stated and by
{stated[1] or 0.0:.4f}° if it is, with a global shutter by {moving[1] or 0.0:.4f}°.

**JPEG.** Quality 50, and 75 with gamma 1, leaves blocks in the dim luminance of a red spot: most of such
spots are refused as `distorted` or `wrong_shape`. What passes is right, with a sigma two to four times too
large.

**Mistakes.** A gain that hunts and a defocused lens change nothing. A wrong scale, a tilted screen and a
wrong `beam_mm` (`altd record --beam`) fit any camera, so two plates alone do not show them. Values are wrong
and valid if the plate's header does not state scale and tilt as uncertain, so `altd record` refuses such a
plate of a unit on a desk; with the statement they are in sigma.
""",
        figure=figure,
        caption="Errors of a desk unit and their ratio to sigma; lines: the aim of 0.05 mm, and 1.25",
    )
