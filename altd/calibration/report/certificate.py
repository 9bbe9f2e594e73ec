"""A calibration certificate: results and sections that precede the report (docs/calibrate.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from altd.calibration.report.budget import COVERAGE, Budget, Uncertainty, term_name, unit_of_term
from altd.calibration.report.certificate_facts import Contact, Equipment, Facts
from altd.calibration.report.document import Block, Heading, Table, Words
from altd.calibration.report.prediction import name_of, two_digits, unit_of
from altd.calibration.report.write import Source
from altd.instruments.beam.instrument import MAX_PITCH_MM_PER_M, MAX_YAW_MM_PER_M


@dataclass(frozen=True, slots=True)
class CertifiedResult:
    """The correction that remains with the calibration file, which is 0, and its uncertainty by the budget.

    ``rms`` is over the beams of the range, ``worst`` at its worst place, in the unit at the end of ``key``.
    """

    key: str
    rms: Uncertainty
    worst: Uncertainty

    @property
    def name(self) -> str:
        """Name of the result as printed."""
        return f"remaining correction of {name_of(self.key)}"


def results_of(budget: Budget) -> tuple[CertifiedResult, ...]:
    """The results for each quantity of the calibrated unit."""
    columns = zip(budget.quantities, budget.rms, budget.worst, strict=True)
    return tuple(CertifiedResult(*column) for column in columns)


MEASURAND = (
    "The axis of the laser beam in the frame of the unit: x and y where it meets the reference plane, and "
    "yaw = atan(sx) and pitch = atan(sy) of its slopes sx and sy. Seen along the beam, x and yaw are "
    "positive to the right, y and pitch upwards. The reference plane is the printed surface of the first "
    "target, z = 0."
)


def conditions(facts: Facts, source: Source, budget: Budget) -> tuple[tuple[str, str], ...]:
    """Names and texts of the range and conditions for which the results hold, and of the unit's state."""
    calibration = source.calibration
    first, *others = calibration.targets
    low, high = first.map.hull_mm.min(axis=0), first.map.hull_mm.max(axis=0)
    area = f"x {low[0]:.1f} to {high[0]:.1f}, y {low[1]:.1f} to {high[1]:.1f} mm"
    slopes = (
        f"yaw ±{MAX_YAW_MM_PER_M:g}, pitch ±{MAX_PITCH_MM_PER_M:g} mm/m, where the beam meets all targets"
    )
    celsius, kelvin = calibration.temperature_c, calibration.limits.temperature_k
    of_frame = "not stated" if celsius is None else f"{celsius:.1f} °C"
    service = "not stated" if kelvin is None else f"{kelvin:g} K (standard uncertainty)"
    residuals = (f"{of.name} {two_digits(of.residual_mean_mm)} mm" for of in calibration.targets)
    return (
        ("Range", f"{area}; {slopes}" if others else area),
        ("Measurement", f"mean of {budget.exposures} exposures of a beam at rest, as in the scan"),
        ("Temperature of the frame", f"{of_frame} in the scan; difference from it in service: {service}"),
        ("As found", facts.as_found or "not determined"),
        ("As left", f"corrected by the calibration file; mean distance of the nodes: {', '.join(residuals)}"),
    )


def second_scan(source: Source) -> str:
    """Return whether a scan of the turned unit has shown the calibrating beam's tilt."""
    if any(header.turned_deg for header in source.headers):
        return "determined by a second scan, of the unit turned by 180°"
    return "the unit was not scanned turned by 180°"


def references(facts: Facts, source: Source) -> tuple[tuple[str, str, str], ...]:
    """Each reference with its standard uncertainty and its traceability, as the user states them."""
    limits, origin = source.calibration.limits, facts.traceability
    beam = second_scan(source)
    if not any(header.turned_deg for header in source.headers):
        beam = f"{origin.beam or 'not stated: not traceable'}; {beam}"
    return tuple(
        (
            name,
            ", ".join(
                f"{term_name(key)} {'not stated' if u is None else f'{u:.3g} {unit_of_term(key)}'}"
                for key in keys
                for u in [getattr(limits, key)]
            ),
            text or "not stated: not traceable",
        )
        for name, keys, text in (
            ("stage", ("stage_mm", "stage_scale_ppm", "stage_square_mrad"), origin.stage),
            ("calibrating beam", ("beam_normal_mm_per_m",), beam),
            ("distance of the targets", ("target_distance_mm",), origin.distance),
        )
    )


def identifications(source: Source) -> tuple[tuple[str, str], ...]:
    """Names and numbers of the unit and its cameras."""
    cameras = (
        (f"camera of target {target.name}", target.camera.serial) for target in source.calibration.targets
    )
    known = tuple((name, serial) for name, serial in cameras if serial is not None)
    return (("serial number", source.calibration.unit_serial), *known)


def sections(facts: Facts, source: Source, budget: Budget) -> list[Block]:
    """The certificate's sections, after its verdict."""
    temperature = facts.environment
    about = (
        ("Certificate", facts.number),
        ("Calibrated item", f"Active Laser Target {facts.unit.model}, {facts.unit.manufacturer}"),
        *((name.capitalize(), value) for name, value in identifications(source)),
        ("Customer", _address(facts.customer)),
        ("Laboratory", _address(facts.laboratory)),
        ("Performed", facts.performed.isoformat()),
        ("Procedure", facts.procedure),
        (
            "Environment",
            f"temperature ({temperature.temperature_c:g} ± {temperature.temperature_expanded_k:g}) °C, k = 2",
        ),
        ("Measurand", MEASURAND),
        *conditions(facts, source, budget),
        ("Recalibration due", "not stated" if facts.valid_until is None else facts.valid_until.isoformat()),
    )
    return [
        Heading("Identification"),
        Table((), about, (0.25, 0.75)),
        Heading("Equipment and traceability"),
        Table(
            ("", "manufacturer, model", "serial number", "certificate"),
            tuple(_equipment(one) for one in facts.equipment),
            (0.2, 0.3, 0.2, 0.3),
        ),
        Table(
            ("reference", "standard uncertainty", "traceable to"), references(facts, source), (0.2, 0.4, 0.4)
        ),
        Heading("Results"),
        Words(
            "The calibration file applies the corrections; zero remains. The expanded uncertainty is the "
            f"combined standard uncertainty of a measurement of {budget.exposures} exposures times the "
            f"coverage factor k, for a coverage probability of {100 * COVERAGE:.0f} %; see the uncertainty "
            "budget. It is given as the root mean square over the range, and at its worst place. The results "
            "hold for the item at the time of calibration."
            + (f" Not stated, so not contained: {budget.missing}." if budget.not_stated else "")
        ),
        Table(
            ("", "value", "standard uncertainty, rms", "expanded, rms (k)", "expanded, at worst (k)"),
            tuple(_row(result) for result in results_of(budget)),
            (0.3, 0.1, 0.2, 0.18, 0.22),
        ),
        Heading("Signature"),
        Table(
            (),
            ((f"{facts.operator.name}, {facts.operator.role}", ""), ("Date", ""), ("Signature", "")),
            (0.4, 0.6),
        ),
    ]


def _row(result: CertifiedResult) -> tuple[str, ...]:
    unit = unit_of(result.key)
    expanded = (
        f"{two_digits(of.expanded)}{unit} ({of.coverage_factor:.2f})" for of in (result.rms, result.worst)
    )
    return result.name, f"0{unit}", f"{two_digits(result.rms.standard)}{unit}", *expanded


def _address(contact: Contact) -> str:
    town = " ".join(filter(None, (contact.post_code, contact.city)))
    parts: Sequence[str | None] = (
        contact.name, contact.street, town, contact.country, contact.email,
        contact.code and f"accreditation {contact.code}",
    )  # fmt: skip
    return ", ".join(part for part in parts if part)


def _equipment(one: Equipment) -> tuple[str, str, str, str]:
    if one.certificate is None:
        return one.name, f"{one.manufacturer}, {one.model}", one.serial, "none: not traceable"
    until = None if one.valid_until is None else f"valid until {one.valid_until.isoformat()}"
    by = ", ".join(filter(None, (one.certificate, one.calibrated_by, until)))
    return one.name, f"{one.manufacturer}, {one.model}", one.serial, by
