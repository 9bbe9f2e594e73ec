from __future__ import annotations

from support.places import ROOT

from altd.publish.modbus.registers import REGISTERS
from altd.publish.modbus.status import REASON_CODES, STATUS_BITS
from tools.pages.modbus import page

COMMITTED = ROOT / "docs" / "modbus.md"


def test_the_page_in_docs_is_the_generated_one() -> None:
    assert COMMITTED.read_text() == page(), "run: python -m tools.pages.modbus > docs/modbus.md"


def test_the_page_names_every_register_bit_and_code() -> None:
    text = page()
    for row in REGISTERS:
        assert f"`{row.name}`" in text
        assert f"| {row.address} |" in text
    for bit in STATUS_BITS:
        assert f"| {bit.bit} | {bit.name} |" in text
    for reason in REASON_CODES:
        assert f"| {reason.modbus_code} | `{reason}` |" in text
