"""A certificate as XML in the structure of the Digital Calibration Certificate, version 3.3.0.

The elements are those of the namespaces https://ptb.de/dcc and https://ptb.de/si, in the order of their
sequences. A unit's file validates, but for the number of its version, against the PTB's schemas of the
certificate 3.2.1 and of D-SI 2.2.0, which are not part of this repository.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

from altd import __version__
from altd.calibration.file import file_of
from altd.calibration.report.budget import COVERAGE, Budget
from altd.calibration.report.certificate import MEASURAND, conditions, identifications, references, results_of
from altd.calibration.report.certificate_facts import Contact, Equipment, Facts
from altd.calibration.report.prediction import name_of, two_digits
from altd.calibration.report.verdict import RULE, judge
from altd.calibration.report.write import Source

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
SCHEMA_VERSION = "3.3.0"
_UNITS = {"mm": r"\milli\metre", "deg": r"\degree"}
"""D-SI names of the units at the end of a quantity's key."""

Element = ElementTree.Element


def dcc_xml(facts: Facts, source: Source, budget: Budget) -> bytes:
    """Render the certificate as UTF-8 XML."""
    ElementTree.register_namespace("dcc", DCC)
    ElementTree.register_namespace("si", SI)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA_VERSION})
    _administrative_data(_add(root, "administrativeData"), facts, source, budget)
    result = _add(_add(root, "measurementResults"), "measurementResult")
    _named(result, "Calibration of an Active Laser Target")
    method = _add(_add(result, "usedMethods"), "usedMethod")
    _named(method, facts.procedure)
    _equipment(_add(result, "measuringEquipments"), facts.equipment)
    condition = _add(_add(result, "influenceConditions"), "influenceCondition", refType="basic_temperature")
    _named(condition, "temperature")
    temperature = facts.environment
    real = _real(_add(condition, "data"), "temperature", temperature.temperature_c, r"\degreecelsius")
    _expanded(real, temperature.temperature_expanded_k, 2.0, "normal")
    _results(_add(result, "results"), budget)
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"


def _administrative_data(parent: Element, facts: Facts, source: Source, budget: Budget) -> None:
    software = _add(_add(parent, "dccSoftware"), "software")
    _named(software, "altd")
    _add(software, "release", __version__)
    core = _add(parent, "coreData")
    _add(core, "countryCodeISO3166_1", facts.laboratory.country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", facts.number)
    file = _add(_add(core, "identifications"), "identification")
    _add(file, "issuer", "calibrationLaboratory")
    _add(file, "value", file_of(source.calibration).sha256)
    _named(file, "SHA-256 of the calibration file")
    _add(core, "beginPerformanceDate", facts.performed.isoformat())
    _add(core, "endPerformanceDate", facts.performed.isoformat())
    _add(core, "performanceLocation", "laboratory")
    item = _add(_add(parent, "items"), "item")
    _named(item, "Active Laser Target")
    _named(_add(item, "manufacturer"), facts.unit.manufacturer)
    _add(item, "model", facts.unit.model)
    numbers = _add(item, "identifications")
    for name, value in identifications(source):
        number = _add(numbers, "identification")
        _add(number, "issuer", "manufacturer")
        _add(number, "value", value)
        _named(number, name)
    laboratory = _add(parent, "calibrationLaboratory")
    if facts.laboratory.code is not None:
        _add(laboratory, "calibrationLaboratoryCode", facts.laboratory.code)
    _contact(_add(laboratory, "contact"), facts.laboratory)
    person = _add(_add(parent, "respPersons"), "respPerson")
    _named(_add(person, "person"), facts.operator.name)
    _add(person, "role", facts.operator.role)
    _add(person, "mainSigner", "true")
    _contact(_add(parent, "customer"), facts.customer)
    statements = _statements(facts, source, budget)
    parent_of = _add(parent, "statements")
    for text in statements:
        _add(_add(_add(parent_of, "statement"), "declaration"), "content", text, lang="en")


def _statements(facts: Facts, source: Source, budget: Budget) -> list[str]:
    simulated = ["Made from SIMULATED frames: not for a real unit."] if source.calibration.simulated else []
    until = facts.valid_until
    verdict = judge(source.calibration, source.evidence, budget)
    return [
        *simulated,
        *([] if until is None else [f"Recalibration is due on {until.isoformat()}."]),
        f"Measurand: {MEASURAND}",
        *(f"{name}: {text}." for name, text in conditions(facts, source, budget)),
        *(
            f"Reference, {name}: {uncertainty}; {origin}."
            for name, uncertainty, origin in references(facts, source)
        ),
        f"{verdict.headline} {RULE}",
    ]


def _equipment(parent: Element, equipment: tuple[Equipment, ...]) -> None:
    for one in equipment:
        element = _add(parent, "measuringEquipment")
        _named(element, one.name)
        if one.certificate is not None:
            traced = ", ".join(filter(None, (one.certificate, one.calibrated_by)))
            text = f"certificate {traced}"
            if one.valid_until is not None:
                text += f", valid until {one.valid_until.isoformat()}"
        else:
            text = "not traceable"
        _add(_add(element, "description"), "content", text, lang="en")
        _named(_add(element, "manufacturer"), one.manufacturer)
        _add(element, "model", one.model)
        number = _add(_add(element, "identifications"), "identification")
        _add(number, "issuer", "manufacturer")
        _add(number, "value", one.serial)
        _named(number, "serial number")


def _results(parent: Element, budget: Budget) -> None:
    for result in results_of(budget):
        element = _add(parent, "result")
        _named(element, result.name)
        data = _add(element, "data")
        for name, of in (
            (f"{result.name}, root mean square over the range", result.rms),
            (f"{result.name}, at the worst place of the range", result.worst),
        ):
            free = of.degrees_of_freedom
            distribution = f"Student t, {free:.0f} degrees of freedom" if math.isfinite(free) else "normal"
            _expanded(
                _real(data, name, 0.0, _unit(result.key)), of.expanded, of.coverage_factor, distribution
            )
    element = _add(parent, "result")
    _named(element, "uncertainty budget")
    data = _add(element, "data")
    for place, key in enumerate(budget.quantities):
        terms = _add(data, "list")
        _named(terms, f"contributions to the standard uncertainty of {name_of(key)}")
        for term in budget.terms:
            _real(terms, term.name, term.contributions[place], _unit(key))


def _unit(key: str) -> str:
    return _UNITS[key.rsplit("_", 1)[1]]


def _real(parent: Element, name: str, value: float, unit: str) -> Element:
    quantity = _add(parent, "quantity")
    _named(quantity, name)
    real = ElementTree.SubElement(quantity, f"{{{SI}}}real")
    _si(real, "value", f"{value:.4g}")
    _si(real, "unit", unit)
    return real


def _expanded(real: Element, expanded: float, coverage_factor: float, distribution: str) -> None:
    uncertainty = _si(_si(real, "measurementUncertaintyUnivariate"), "expandedMU")
    _si(uncertainty, "valueExpandedMU", two_digits(expanded))
    _si(uncertainty, "coverageFactor", f"{coverage_factor:.3g}")
    _si(uncertainty, "coverageProbability", f"{COVERAGE:g}")
    _si(uncertainty, "distribution", distribution)


def _contact(parent: Element, contact: Contact) -> None:
    _named(parent, contact.name)
    _add(parent, "eMail", contact.email)
    location = _add(parent, "location")
    _add(location, "city", contact.city)
    _add(location, "countryCode", contact.country)
    if contact.post_code is not None:
        _add(location, "postCode", contact.post_code)
    if contact.street is not None:
        _add(location, "street", contact.street)


def _named(parent: Element, name: str) -> None:
    _add(_add(parent, "name"), "content", name, lang="en")


def _add(parent: Element, name: str, text: str | None = None, **attributes: str) -> Element:
    element = ElementTree.SubElement(parent, f"{{{DCC}}}{name}", attributes)
    element.text = text
    return element


def _si(parent: Element, name: str, text: str | None = None) -> Element:
    element = ElementTree.SubElement(parent, f"{{{SI}}}{name}")
    element.text = text
    return element
