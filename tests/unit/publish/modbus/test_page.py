from __future__ import annotations

import re

from support.places import ROOT

from altd.publish.modbus.registers import REGISTERS
from altd.publish.modbus.values import REASON_CODES, STATUS_BITS
from tools.pages.modbus import page

COMMITTED = ROOT / "docs" / "modbus.md"


def test_the_page_in_docs_is_the_generated_one() -> None:
    assert COMMITTED.read_text() == page(), "run: make pages"


def test_the_page_names_every_register_bit_and_code() -> None:
    text = page()
    for row in REGISTERS:
        assert f"`{row.name}`" in text
        assert re.search(rf"^\|.*\b{row.address}\b.*\|.*`{row.name}`", text, re.MULTILINE)
    for bit in STATUS_BITS:
        assert f"| {bit.bit} | {bit.name} |" in text
    reasons = (ROOT / "docs" / "reasons.md").read_text()
    for reason in REASON_CODES:
        assert f"| `{reason}` | {reason.scope} | {reason.modbus_code} |" in reasons


def test_the_page_says_which_bits_a_valid_measurement_may_have_and_which_warnings_have_none() -> None:
    text = " ".join(page().split())
    bit_15 = next(line for line in page().splitlines() if line.startswith("| 15 |"))
    assert "with bit 0 at 1 a warning: `geometry_suspect`, `geometry_unknown`, `compensated` |" in bit_15
    assert "Bits 7, 12, 13 and 15 may be set beside bit 0, as warnings" in text
    assert "The warnings `rehearsal`, `roll_missing`, `pitch_diverges` have no bit." in text
    assert "2 at once for a rehearsal, 4 after ten seconds for the inclinometer" in text
