"""The contents of the report, in the order in which a reader needs them."""

from __future__ import annotations

import platform

import cv2
import matplotlib
import numpy as np

from altd import __version__
from altd.calibration.file import file_of
from altd.calibration.report import map_plots, target_plots
from altd.calibration.report.budget import Budget, budget_of, budget_section
from altd.calibration.report.certificate import second_scan, sections
from altd.calibration.report.certificate_facts import Facts
from altd.calibration.report.document import (
    Banner,
    Block,
    Document,
    Heading,
    Level,
    Picture,
    Row,
    Table,
    Words,
)
from altd.calibration.report.map_sections import covariances, cross_checks, models, residuals
from altd.calibration.report.picture_sections import pictures
from altd.calibration.report.prediction import CAUSES, OF_SPOT, Prediction, name_of, predict
from altd.calibration.report.target_plots import ShownArea, ValueGrid
from altd.calibration.report.verdict import RULE, ReportVerdict, judge
from altd.calibration.report.write import Source, target_names_text
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.header import CameraHeader
from altd.records import utc_text

_PER_UNIT = 1000
"""Factor for pictures, which are in thousandths of a degree or of a millimetre."""


def beam_section(prediction: Prediction, source: Source) -> list[Block]:
    """Section on the predicted sigma over the area, its causes and the effect of averaging."""
    targets, exposures = source.calibration.targets, prediction.exposures
    plane = ShownArea([target.map.hull_mm for target in targets], around_mm=3.0)
    if prediction.quantities == OF_SPOT:
        caption = (
            "Predicted sigma (1 standard deviation) of one measurement of a spot on the target, "
            f"{exposures} exposures averaged. Seen along the beam; x and y share one scale."
        )
        rows = [Row(_pair(prediction, plane, "x_mm", "y_mm"), caption)]
    else:
        caption = (
            "Predicted sigma (1 standard deviation) of one measurement over the area, from "
            f"{target_names_text(targets)} together: a beam normal to the targets at (x, y), "
            f"{exposures} exposures averaged. Seen along the beam; yaw and pitch share one scale, "
            "x and y another."
        )
        rows = [
            Row(_pair(prediction, plane, "x_mm", "y_mm"), ""),
            Row(_pair(prediction, plane, "yaw_deg", "pitch_deg"), caption),
        ]
    names = tuple(map(name_of, prediction.quantities))
    budget = map_plots.budget("contributions to sigma", names, prediction.shares, CAUSES)
    window = np.geomspace(1, 100, 60)
    last_two = prediction.quantities[-2:]
    sigmas = [
        (name_of(quantity), _PER_UNIT * prediction.rms_after(quantity, window)) for quantity in last_two
    ]
    averaging = map_plots.averaging(
        "effect of averaging", window, sigmas, exposures, f"sigma in {_unit(last_two[0])}, rms"
    )
    made_of = (
        "Pattern: print and speckle shift each spot by a fixed amount that differs from place to place. "
        "Map: its uncertainty from the noise of the nodes. Scatter: single exposures about their mean, "
        f"{exposures} averaged; only it falls with more exposures. Limits: stated uncertainties of stage "
        "and beam, which the scan does not show."
    )
    return [
        Heading("Predicted uncertainty of a measurement"),
        *rows,
        Row(
            (
                Picture("contributions to sigma", map_plots.BUDGET_IN, budget),
                Picture("sigma over the number of exposures averaged", map_plots.BUDGET_IN, averaging),
            ),
            made_of,
        ),
    ]


def _pair(prediction: Prediction, plane: ShownArea, *quantities: str) -> tuple[Picture, ...]:
    """Pictures of the sigma of quantities over the area, on one scale."""
    sigmas = [_PER_UNIT * prediction.sigma[prediction.quantities.index(name)] for name in quantities]
    limits = float(np.nanmin(sigmas)), float(np.nanmax(sigmas))
    pictures = []
    for quantity, sigma in zip(quantities, sigmas, strict=True):
        name = name_of(quantity)
        over = ValueGrid(prediction.x_mm, prediction.y_mm, sigma)
        draw = target_plots.contours(plane, f"sigma of {name}", over, limits, _unit(quantity))
        pictures.append(Picture(f"predicted sigma of {name} over the area", plane.height_in(bar=True), draw))
    return tuple(pictures)


def _unit(quantity: str) -> str:
    return "µm" if quantity in OF_SPOT else "10⁻³ °"


def report_on(source: Source, budget: Budget | None = None, facts: Facts | None = None) -> Document:
    """Compute, judge and arrange the report; ``budget`` is the calibration's, if the caller has computed it.

    With ``facts`` the report is a calibration certificate. Raises ValueError when the targets have no common
    area.
    """
    budget = budget or budget_of(source.calibration, source.evidence)
    prediction = predict(source.calibration)
    file = file_of(source.calibration)
    verdict = judge(source.calibration, source.evidence, budget)
    blocks = [
        *_origin(source.calibration),
        Banner(
            verdict.level,
            verdict.headline,
            (*verdict.uncertainty, verdict.limit, *(verdict.remedies or (verdict.advice,))),
        ),
        *([] if facts is None else sections(facts, source, budget)),
        *_criteria(verdict),
        *beam_section(prediction, source),
        *budget_section(budget),
        *residuals(source),
        *models(source),
        *cross_checks(source),
        *covariances(source),
        *pictures(source),
        *_left_out(source),
        *_inputs(source, file.sha256),
    ]
    serial = source.calibration.unit_serial
    made = source.calibration.created.strftime("%Y-%m-%d %H:%M UTC")
    return Document(
        f"Calibration of unit {serial}" if facts is None else f"Calibration certificate {facts.number}",
        f"{source.calibration.recording_note} · {made}",
        tuple(blocks),
        file.checksum,
        "SIMULATED" if source.calibration.simulated else "",
    )


def _origin(calibration: Calibration) -> list[Block]:
    """Mark the report of a simulated unit, so that it is not mistaken for that of a real one."""
    if not calibration.simulated:
        return []
    names = " and ".join(target.name for target in calibration.targets if target.simulated)
    lines = (
        f"No camera took the frames of {names}. This report describes the simulated unit only.",
        "Measurements with this calibration are marked “simulated”.",
    )
    return [Banner(Level.BAD, "Made from SIMULATED frames: not for a real unit.", lines)]


def _criteria(verdict: ReportVerdict) -> list[Block]:
    return [
        Heading("Criteria"),
        Words(RULE),
        Table(
            ("", "found", "required", ""),
            tuple((check.name, check.value, check.wanted, check.level.word) for check in verdict.checks),
            (0.3, 0.33, 0.23, 0.14),
            tuple(check.level for check in verdict.checks),
        ),
    ]


def _left_out(source: Source) -> list[Block]:
    rows = tuple(
        (target.name, f"{x:g}", f"{y:g}", reason)
        for target, seen in source.targets()
        for (x, y), reason in seen.excluded
    )
    blocks: list[Block] = [Heading("Nodes left out")]
    if rows:
        blocks.append(Table(("target", "x, mm", "y, mm", "reason"), rows, (0.12, 0.1, 0.1, 0.68)))
    else:
        blocks.append(Words("None: every node of the scan was used."))
    less = [
        f"{target.name} x {x:g} y {y:g} mm: 1/{sigma**2:.1f}"
        for target, seen in source.targets()
        for (x, y), sigma in zip(seen.nodes_mm.tolist(), seen.relative_sigma.tolist(), strict=True)
        if sigma > 1.0
    ]
    if less:
        words = "Nodes with less certain spots, as those cut by the picture's edge, have a smaller weight"
        blocks.append(Words(f"{words}: {'; '.join(less)}."))
    return blocks


def _located(target: TargetCalibration) -> str:
    """Describe the method that locates the target's spots."""
    if target.flat is not None:
        return {
            "recording": "through a recorded flat",
            "laser": "through a flat made with the laser",
            "service": "through a flat learnt in service",
            "print": "through a model of the print",
        }[target.flat.source]
    return {
        "profile": "as on a plain target",
        "moment": "by their centre of light",
        "auto": "as each one asks",
    }[target.localiser.method]


def _described(camera: CameraHeader) -> str:
    """Describe a camera with its exposure time and gain, as far as they are recorded."""
    told = (
        camera.model,
        camera.serial and f"serial {camera.serial}",
        camera.driver and f"driver {camera.driver}",
        None if camera.exposure_ms is None else f"exposure {camera.exposure_ms:g} ms",
        None if camera.gain_db is None else f"gain {camera.gain_db:g} dB",
    )
    known = ", ".join(part for part in told if part)
    return f"{known or 'serial, exposure and gain not known'}; frames: {camera.origin}"


def _recordings(source: Source) -> list[tuple[str, str]]:
    """Facts on the source of the calibration: one recording, or several by their numbers."""
    calibration, several = source.calibration, len(source.headers) > 1
    facts = [
        ("Recordings" if several else "Recording", calibration.recording_note),
        ("SHA-256 over theirs" if several else "SHA-256 of the recording", calibration.recording_sha256),
    ]
    for number, header in enumerate(source.headers, start=1):
        which = f"{number}: " if several else ""
        if several:
            facts.append((f"Recording {number}", f"{header.kind}, {header.note or 'without a note'}"))
        facts.append((f"{which}Recorded by", header.made_by or "not known"))
        looks_at = {target.camera: target.name for target in header.shown_targets}
        for name, camera in header.cameras.items():
            target = looks_at.get(name, name)
            role = "" if target == name else f", target {target}"
            facts.append((f"{which}Camera {name}{role}", _described(camera)))
    return facts


def _inputs(source: Source, file_sha256: str) -> list[Block]:
    calibration = source.calibration
    exposures = "; ".join(f"{seen.name} {sum(seen.exposures)}" for seen in source.evidence)
    facts = [
        ("Unit", calibration.unit_serial),
        *_recordings(source),
        ("Calibrated", utc_text(calibration.created)),
        ("SHA-256 of the calibration file", file_sha256),
        ("Command", source.command),
        ("Exposures used", exposures),
        ("Tilt of the calibrating beam", second_scan(source)),
    ]
    for target in calibration.targets:
        low, high = target.valid_mm.min(axis=0), target.valid_mm.max(axis=0)
        facts.append(
            (
                f"Target {target.name}",
                f"z {target.z_mm:g} mm, "
                + (f"{target.glass} behind it, " if target.glass else "")
                + f"picture {target.width} × {target.height} px, map {target.map.name}, "
                f"spots located {_located(target)}, "
                f"valid within x {low[0]:.1f} to {high[0]:.1f}, y {low[1]:.1f} to {high[1]:.1f} mm",
            )
        )
    facts.append(
        (
            "Made with",
            f"altd {__version__}, numpy {np.__version__}, OpenCV {cv2.__version__}, matplotlib "
            f"{matplotlib.__version__}, Python {platform.python_version()}",
        )
    )
    return [Heading("Inputs and versions"), Table((), tuple(facts), (0.25, 0.75))]
