"""The calibration certificate: facts from a file, sections, and XML in the published structure."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from support.evidence import calibration, evidence
from support.places import ROOT

from altd.calibration.report.budget import Budget, Term, Uncertainty
from altd.calibration.report.certificate import sections
from altd.calibration.report.certificate_facts import load_facts
from altd.calibration.report.dcc import dcc_xml
from altd.calibration.report.document import Table
from altd.calibration.report.prediction import OF_BEAM
from altd.calibration.report.write import Source
from altd.errors import BadInputError

FACTS = (ROOT / "config" / "certificate.toml").read_text()
DCC, SI = "{https://ptb.de/dcc}", "{https://ptb.de/si}"
ORDER = {
    "digitalCalibrationCertificate": "administrativeData measurementResults",
    "administrativeData": "dccSoftware coreData items calibrationLaboratory respPersons customer statements",
    "software": "name release",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1 mandatoryLangCodeISO639_1 uniqueIdentifier "
    "identifications beginPerformanceDate endPerformanceDate performanceLocation",
    "item": "name manufacturer model identifications",
    "identification": "issuer value name",
    "calibrationLaboratory": "calibrationLaboratoryCode contact",
    "respPerson": "person role mainSigner",
    "contact": "name eMail location",
    "customer": "name eMail location",
    "measurementResult": "name usedMethods measuringEquipments influenceConditions results",
    "measuringEquipment": "name description manufacturer model identifications",
    "influenceCondition": "name data",
    "result": "name data",
    "quantity": "name real",
    "real": "value unit measurementUncertaintyUnivariate",
    "list": "name quantity",
    "expandedMU": "valueExpandedMU coverageFactor coverageProbability distribution",
}
"""Children of an element in the order of the published schema, those that a certificate of ours has."""


def source() -> Source:
    return Source(calibration(), (evidence("front"), evidence("rear")), {}, "altd calibrate", ())


def budget() -> Budget:
    """Two terms, of 3 and 4 parts of one, both known without limit: k is 1.96.

    At the worst place 8 parts with 10 degrees of freedom: k is 2.23.
    """
    parts = np.array([0.001, 0.002, 0.0004, 0.0006])
    terms = [
        Term(key, 1.0, "mm", "normal", (math.inf,), (tuple((factor * parts).tolist()),))
        for key, factor in (("map", 3.0), ("stage_scale_ppm", 4.0))
    ]
    return Budget(OF_BEAM, tuple(terms), (), 20, tuple(Uncertainty(8 * u, 10.0) for u in parts.tolist()))


def written(folder: Path, text: str = FACTS) -> Path:
    path = folder / "facts.toml"
    path.write_text(text)
    return path


def test_the_xml_is_well_formed_and_in_the_order_of_the_structure(tmp_path: Path) -> None:
    root = ElementTree.fromstring(dcc_xml(load_facts(written(tmp_path)), source(), budget()))
    assert root.get("schemaVersion") == "3.3.0"
    seen = set()
    for element in root.iter():
        name = element.tag.partition("}")[2]
        children = [child.tag.partition("}")[2] for child in element]
        if name in ORDER:
            seen.add(name)
            possible = ORDER[name].split()
            assert list(dict.fromkeys(children)) == [one for one in possible if one in children], name
    assert seen == set(ORDER)


def test_the_xml_holds_the_expanded_uncertainty_with_its_unit(tmp_path: Path) -> None:
    root = ElementTree.fromstring(dcc_xml(load_facts(written(tmp_path)), source(), budget()))
    found = {}
    for result in root.iter(f"{DCC}result"):
        name = result.findtext(f"{DCC}name/{DCC}content")
        reals = list(result.iter(f"{SI}real"))
        found[name] = [(r.findtext(f"{SI}unit"), r.findtext(f".//{SI}valueExpandedMU")) for r in reals]
    millimetre = r"\milli\metre"
    # combined 5 parts; 1.96 times that
    assert found["remaining correction of x"] == [(millimetre, "0.0098"), (millimetre, "0.018")]
    assert found["remaining correction of pitch"] == [(r"\degree", "0.0059"), (r"\degree", "0.011")]
    factors = {
        e.findtext(f"{SI}coverageFactor"): e.findtext(f"{SI}distribution")
        for e in root.iter(f"{SI}expandedMU")
    }
    assert factors == {"2": "normal", "1.96": "normal", "2.23": "Student t, 10 degrees of freedom"}
    contributions = [each.text for each in root.findall(f".//{DCC}list/{DCC}quantity/{SI}real/{SI}value")]
    assert contributions[:2] == ["0.003", "0.004"]
    assert root.findtext(f".//{DCC}influenceCondition//{SI}value") == "20.4"
    assert root.findtext(f"{DCC}administrativeData/{DCC}calibrationLaboratory//{DCC}content") == "Lab & Co"
    serials = [each.findtext(f"{DCC}value") for each in root.iter(f"{DCC}identification")]
    assert {"TEST-1", "4711", "0815"} <= set(serials)


def test_the_sections_state_the_same(tmp_path: Path) -> None:
    blocks = sections(load_facts(written(tmp_path)), source(), budget())
    text = " ".join(" ".join(row) for block in blocks if isinstance(block, Table) for row in block.rows)
    for words in ("2026-117", "Lab & Co, Munich, DE", "temperature (20.4 ± 0.8) °C", "2027-11-24", "C-1"):
        assert words in text
    assert "remaining correction of x 0 mm 0.0050 mm 0.0098 mm (1.96) 0.018 mm (2.23)" in text
    assert "yaw ±110, pitch ±250 mm/m" in text
    assert "stage positioning of the stage not stated" in text
    assert (
        "calibrating beam against the normal not stated not stated: not traceable; the unit was not" in text
    )
    assert "As found yaw +0.012°, pitch -0.004°" in text
    assert "laser Lasers, L3 0815 none: not traceable" in text


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('number = "2026-117"\n', "", "number: this key is missing"),
        ("temperature_c = 20.4", "temperature_k = 20.4", "; did you mean `temperature_c`?"),
        (
            'country = "AT"',
            'country = "Austria"',
            'line 18, column 11: customer.country: "Austria" has characters that are not allowed',
        ),
        ("valid_until = 2027-11-24", "valid_until = 2026-11-24", "valid_until: is not after performed"),
        ("performed = 2026-11-24", 'performed = "autumn"', '"autumn" cannot be used; possible: date'),
        ("[operator]", "[operator", "line 20, column 10: not TOML"),
        ("temperature_expanded_k = 0.8", "temperature_expanded_k = nan", "nan is not a finite number"),
    ],
)
def test_each_fault_of_the_facts_is_a_line_and_a_place(old: str, new: str, line: str, tmp_path: Path) -> None:
    with pytest.raises(BadInputError) as refused:
        load_facts(written(tmp_path, FACTS.replace(old, new)))
    assert any(line in each for each in refused.value.lines), refused.value.lines
