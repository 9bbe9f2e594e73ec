"""The page's memory of the last minutes, run by Node.js, and what the unit's history adds to it."""

import json
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from support.foreign import need_program

from altd.publish.http.answers import page_files


def columns_of(tmp_path: Path, added: list[Any]) -> Any:
    """Times and x of the page's memory after such measurements with serials, and trends."""
    (tmp_path / "memory.mjs").write_bytes(page_files()["memory.js"].content)
    script = """
        const { Memory } = await import(process.argv[1]);
        const memory = new Memory();
        JSON.parse(process.argv[2]).forEach(added => added.t_s ? memory.fill(added) : memory.add(...added));
        console.log(JSON.stringify(memory.columns("x_mm").slice(0, 2)));
    """
    node = need_program("node", "nodejs")
    module = (tmp_path / "memory.mjs").as_uri()
    command = [node, "--input-type=module", "-e", script, module, json.dumps(added)]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


def test_a_trend_holds_nothing_of_another_unit(tmp_path: Path) -> None:
    """A unit was exchanged for another one, at the same address, while the page was open."""
    units = ["1E4B2D8E", "1E4B2D8E", "00C0FFEE", "00C0FFEE"]
    times_s, xs_mm = columns_of(tmp_path, [[at(second, unit)] for second, unit in enumerate(units)])
    assert xs_mm == [2, 3]
    assert times_s[1] - times_s[0] == 1


def test_a_trend_holds_nothing_of_another_unit_before_this_one_has_measured(tmp_path: Path) -> None:
    mine = [at(1, "1E4B2D8E"), "ALT-1"]
    assert columns_of(tmp_path, [mine, [None, None], [None, "ALT-1"]])[1] == [1]
    assert columns_of(tmp_path, [mine, [None, None], [None, "ALT-2"]])[1] == []


def test_history_fills_a_trend_where_the_page_measured_nothing(tmp_path: Path) -> None:
    """Seconds that the page has itself stay its own; what lost its value keeps none; a gap stays a gap."""
    begin_s = datetime(2026, 11, 20, 8, 15, tzinfo=UTC).timestamp()
    past = {
        "t_s": [begin_s - 601, begin_s, begin_s + 1, begin_s + 2, begin_s + 10],
        "span_s": 1.0,
        "n": [1, 4, 0, 4, 4],
        "n_valid": [1, 4, 0, 0, 4],
        "quantities": {"x_mm": {"mean": [9, 7, None, None, 8], "sigma": [0.1] * 5}},
    }
    times_s, xs_mm = columns_of(tmp_path, [past, [at(10, "1E4B2D8E"), "ALT-1"]])
    assert [time_s - begin_s for time_s in times_s] == pytest.approx([0.5, 2.5, 2.501, 10])
    assert xs_mm == [7, None, None, 10]
    assert columns_of(tmp_path, [past, [at(10, "A"), "ALT-1"], [at(11, "B"), "ALT-2"]])[1] == [11]


def at(second: int, unit: str) -> dict[str, Any]:
    return {"time": f"2026-11-20T08:15:{second:02d}Z", "valid": True, "x_mm": second, "unit": unit}
