"""``altd registers``: prints the Modbus register table for programs that configure a controller."""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
from collections.abc import Iterator
from typing import Any

from altd.process.standard_streams import print_lines

SUMMARY = "print the Modbus register table as JSON, CSV or Structured Text"

_IEC_TYPES = {"u16": "UINT", "u32": "UDINT", "s32": "DINT", "f32": "REAL"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--format",
        choices=("json", "csv", "st"),
        default="json",
        help="output format; st: constants for IEC 61131-3 (default: json)",
    )


def run(options: argparse.Namespace) -> int:
    """Print the table."""
    lines = {"json": _json, "csv": _csv, "st": _structured_text}[options.format]
    for line in lines(list(_rows())):
        print_lines(line)
    return 0


def _rows() -> Iterator[dict[str, Any]]:
    """Yield every register; a number times ``scale`` is in its unit."""
    from altd.publish.modbus import checked_block
    from altd.publish.modbus.machine_blocks import JOINT, MACHINE
    from altd.publish.modbus.registers import (
        FAR,
        FLOAT_BLOCK,
        HEADER,
        NEAR,
        PER_UNIT,
        PLATE_BLOCK,
        SCALED_BLOCK,
        TEST_BLOCK,
    )
    from altd.publish.modbus.unit_blocks import CONDITION, RELATIVE, UNIT

    blocks = {
        "header": HEADER,
        "float": FLOAT_BLOCK,
        "scaled": SCALED_BLOCK,
        "test": TEST_BLOCK,
        "plate": PLATE_BLOCK,
        "checked": checked_block.ROWS,
        "unit": UNIT.rows,
        "condition": CONDITION.rows,
        "relative": RELATIVE.rows,
        "near": NEAR.rows,
        "far": FAR.rows,
        "joint": JOINT.rows,
        "machine": MACHINE.rows,
    }
    for block, rows in blocks.items():
        for row in rows:
            yield {
                "block": block,
                "address": row.address,
                "registers": row.type.words,
                "name": row.name,
                "type": str(row.type),
                "scale": 1 / PER_UNIT if block == "scaled" else 1,
                "unit": row.unit,
                "meaning": row.meaning,
            }


def _codes() -> dict[str, Any]:
    """Meanings of numbers and bits, addresses of commands, and the discrete inputs of function 2."""
    from altd.publish.modbus.responder import SELF_CHECK_ADDRESS, ZERO_ADDRESS
    from altd.publish.modbus.values import (
        DISCRETE_INPUTS,
        PLACE_WARNINGS,
        REASON_CODES,
        ROW_WARNINGS,
        STATUS_BITS,
    )
    from altd.reasons import Signal

    return {
        "status_bits": {row.bit: row.name for row in STATUS_BITS},
        "reasons": {reason.modbus_code: str(reason) for reason in REASON_CODES},
        "place_warning_bits": dict(enumerate(map(str, PLACE_WARNINGS))),
        "row_warning_bits": dict(enumerate(map(str, ROW_WARNINGS))),
        "commands": {SELF_CHECK_ADDRESS: "self_check", ZERO_ADDRESS: "zero"},
        "states": {signal.number: str(signal) for signal in Signal},
        "discrete_inputs": [
            {"address": address, "name": row.name, "meaning": row.meaning}
            for address, row in enumerate(DISCRETE_INPUTS)
        ],
    }


def _json(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield from json.dumps({"registers": rows, **_codes()}, indent=1, ensure_ascii=False).splitlines()


def _csv(rows: list[dict[str, Any]]) -> Iterator[str]:
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    yield from text.getvalue().splitlines()


def _structured_text(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield constants with the addresses, counted from 0, and with the codes; comments contain the types."""
    yield "VAR_GLOBAL CONSTANT"
    for row in rows:
        kind = _IEC_TYPES.get(row["type"], f"STRING[{2 * row['registers']}]")
        about = ", ".join(filter(None, (kind, row["unit"], row["meaning"].replace("`", ""))))
        yield f"    {_identifier(row['block'], row['name'])} : UINT := {row['address']}; (* {about} *)"
    for title, codes in _codes().items():
        if isinstance(codes, dict):
            for number, name in codes.items():
                yield f"    {_identifier(title, name)} : UINT := {number};"
    yield "END_VAR"


def _identifier(*words: str) -> str:
    return re.sub(r"\W", "_", "_".join(("ALT", *words))).upper()
