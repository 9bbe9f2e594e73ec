"""``altd registers``: the table for programs, as json, csv and a reader of Structured Text see it."""

from __future__ import annotations

import csv
import json
import re

from support.cli import altd_here

from altd.publish.modbus.responder import TABLES
from altd.reasons import Reason

ROWS = [row for table in TABLES for row in table.rows]


def test_json_has_every_register_and_code() -> None:
    table = json.loads(altd_here("registers").out)
    assert [(row["address"], row["name"], row["type"]) for row in table["registers"]] == [
        (row.address, row.name, row.type) for row in ROWS
    ]
    x = next(row for row in table["registers"] if row["address"] == 60)
    assert (x["block"], x["name"], x["scale"], x["unit"], x["registers"]) == ("scaled", "x", 0.0001, "mm", 2)
    assert table["reasons"]["29"] == "not_live"
    assert table["status_bits"]["0"] == "valid"
    assert table["commands"] == {"1000": "self_check", "1001": "zero"}
    assert [row["name"] for row in table["discrete_inputs"]][:2] == ["valid", "failure"]


def test_csv_has_the_same() -> None:
    rows = list(csv.DictReader(altd_here("registers", "--format", "csv").out.splitlines()))
    assert [(int(row["address"]), row["name"]) for row in rows] == [(row.address, row.name) for row in ROWS]
    assert next(row for row in rows if row["name"] == "yaw")["unit"] == "°"


def test_structured_text_has_a_constant_for_each_and_no_name_twice() -> None:
    first, *lines, last = altd_here("registers", "--format", "st").out.splitlines()
    assert (first, last) == ("VAR_GLOBAL CONSTANT", "END_VAR")
    constant = re.compile(r"    (ALT_[A-Z0-9_]+) : UINT := (\d+);( \(\* [^*]+ \*\))?")
    found = [constant.fullmatch(line) for line in lines]
    assert all(found)
    names = [match[1] for match in found if match]
    assert len(set(names)) == len(names)
    assert "    ALT_CHECKED_STATUS : UINT := 220; (* UINT, status word as at address 0 *)" in lines
    assert f"    ALT_REASONS_STALE : UINT := {Reason.STALE.modbus_code};" in lines
