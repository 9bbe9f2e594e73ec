"""A calibration certificate: results and sections that precede the report (docs/calibrate.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from altd.calibration.report.budget import COVERAGE, Budget
from altd.calibration.report.certificate_facts import Contact, Equipment, Facts
from altd.calibration.report.document import Block, Heading, Table, Words
from altd.calibration.report.prediction import name_of, unit_of
from altd.calibration.report.write import Source


@dataclass(frozen=True, slots=True)
class CertifiedResult:
    """The correction that remains with the calibration file, which is 0, and its uncertainty by the budget.

    ``standard`` and ``expanded`` are in the unit at the end of ``key``.
    """

    key: str
    standard: float
    expanded: float
    coverage_factor: float

    @property
    def name(self) -> str:
        """Name of the result as printed."""
        return f"remaining correction of {name_of(self.key)}"


def results_of(budget: Budget) -> tuple[CertifiedResult, ...]:
    """The results for each quantity of the calibrated unit."""
    columns = zip(budget.quantities, budget.combined, budget.expanded, budget.coverage_factors, strict=True)
    return tuple(CertifiedResult(*column) for column in columns)


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
        Heading("Results"),
        Words(
            "The calibration file applies the corrections; zero remains. The expanded uncertainty is the "
            f"combined standard uncertainty of a measurement of {budget.exposures} exposures times the "
            f"coverage factor k, for a coverage probability of {100 * COVERAGE:.0f} %; see the uncertainty "
            "budget. The results hold for the item at the time of calibration."
        ),
        Table(
            ("", "value", "standard uncertainty", "k", "expanded uncertainty"),
            tuple(_row(result) for result in results_of(budget)),
            (0.35, 0.12, 0.2, 0.1, 0.23),
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
    numbers = f"{result.standard:.4f}{unit}", f"{result.coverage_factor:.2f}", f"{result.expanded:.4f}{unit}"
    return result.name, f"0{unit}", *numbers


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
