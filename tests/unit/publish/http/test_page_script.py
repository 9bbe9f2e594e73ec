"""The page's link to the unit, run by Node.js: it knows nothing that was not said within the last seconds.

The network and the clock are the test's; a browser shows the page in tests/system/publish/http.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.foreign import need_program

from altd.publish.http.page import page_files
from altd.status.measurement_json import as_object_now
from tools.pages.example import AGE_S, MEASURED

STATUS_PATH, MEASUREMENT_PATH = "/api/v1/status", "/api/v1/measurement"
HERE = Path(__file__).parent

VALID = as_object_now(MEASURED, AGE_S)
STATUS = {
    "serial": "ALT-0007",
    "components": {
        "camera rear": {"state": "degraded", "message": "no frame for 0.3 s", "for_s": 0.1, "frames": 120},
        "http": {"state": "ok", "message": "port 80", "for_s": 9.0},
    },
}
WELL = {STATUS_PATH: STATUS, MEASUREMENT_PATH: VALID}
NOTHING = {"x_mm": "\N{EN DASH}", "sigma_x_mm": "", "sequence": None, "components": []}
NO_VALUES = {"x_mm": "\N{EN DASH}", "sigma_x_mm": "", "sequence": None}


class Page:
    """The page in a process of its own; each order gives back what it then shows."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def do(self, **order: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        shown: dict[str, Any] = json.loads(self._process.stdout.readline())
        return shown

    def measuring(self) -> dict[str, Any]:
        """Open the stream, with one measurement and a look at the components."""
        self.do(answers=WELL, opened=True, message=VALID)
        return self.do(tick=True)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    for name in ("link", "words"):
        (tmp_path / f"{name}.mjs").write_bytes(page_files()[f"{name}.js"].content)
    command = [need_program("node", "nodejs"), str(HERE / "page_in_node.mjs"), str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Page(process)
        process.kill()


def test_it_shows_what_the_unit_says(page: Page) -> None:
    shown = page.measuring()
    assert (shown["verdict"], shown["kind"], shown["x_mm"]) == ("valid", "good", "10.012")
    assert shown["sigma_x_mm"] == "± 0.029 (1σ)"  # √(0.004² + 0.0102² + (0.0512 · 0.52)²) mm
    assert shown["components"] == ["camera rear", "http"]
    assert shown["sequence"] == 160
    assert shown["asked"] == [STATUS_PATH]  # the stream tells the rest


def test_where_nobody_knows_how_the_beam_moves_its_sigma_is_said_to_be_that_at_rest(page: Page) -> None:
    unknown = {**VALID, "sigma_now": dict.fromkeys(VALID["sigma"])}
    shown = page.do(answers=WELL, opened=True, message=unknown)
    assert shown["sigma_x_mm"] == "± 0.004 (at rest)"


def test_with_the_connection_all_goes_that_is_not_known_any_more(page: Page) -> None:
    page.measuring()
    shown = page.do(answers={}, pass_ms=1000, tick=True)
    assert (shown["verdict"], shown["kind"]) == ("no connection to the unit", "unknown")
    assert shown.items() >= NOTHING.items()


def test_a_stream_that_breaks_takes_its_values_along_and_the_state_is_asked_at_once(page: Page) -> None:
    page.measuring()
    shown = page.do(answers={}, broken=2)
    assert shown["asked"] == [STATUS_PATH]
    assert shown.items() >= NOTHING.items()


def test_a_unit_that_does_not_answer_is_given_up(page: Page) -> None:
    """A cable that was cut: nothing fails, nothing comes."""
    page.measuring()
    page.do(answers={STATUS_PATH: "silent"}, pass_ms=1000, tick=True)
    shown = page.do(pass_ms=1500, give_up=True)
    assert shown["verdict"] == "no connection to the unit"
    assert shown.items() >= NOTHING.items()


def test_a_page_that_slept_shows_nothing_old_while_it_asks(page: Page) -> None:
    page.measuring()
    shown = page.do(answers={STATUS_PATH: "silent"}, pass_ms=3_600_000, tick=True)
    assert shown["verdict"] == "no news from the unit"
    assert shown.items() >= NOTHING.items()


def test_where_the_stream_is_silent_the_measurement_is_asked_for(page: Page) -> None:
    """Behind a proxy that holds the stream back, or where measurements are far between."""
    page.measuring()
    stale = {**VALID, "valid": False, "status": ["stale"], "x_mm": None}
    stale["sigma"] = stale["sigma_now"] = dict.fromkeys(VALID["sigma"])
    shown = page.do(answers={**WELL, MEASUREMENT_PATH: stale}, pass_ms=1000, tick=True)
    assert shown["asked"] == [STATUS_PATH, MEASUREMENT_PATH]
    assert (shown["verdict"], shown["x_mm"]) == ("not valid", "\N{EN DASH}")


def test_before_the_first_measurement_it_says_so(page: Page) -> None:
    answers = {STATUS_PATH: STATUS, MEASUREMENT_PATH: {"error": "nothing", "status": ["warming_up"]}}
    shown = page.do(answers=answers, opened=True, pass_ms=1000, tick=True)
    assert (shown["verdict"], shown["kind"], shown["sequence"]) == ("nothing measured yet", "unknown", None)


def test_a_unit_that_is_back_is_shown_again_with_one_stream(page: Page) -> None:
    page.measuring()
    page.do(answers={}, pass_ms=1000, tick=True)
    shown = page.do(answers=WELL, pass_ms=1000, tick=True)
    assert (shown["verdict"], shown["streams"]) == ("valid", 2)
    shown = page.do(opened=True, message={**VALID, "sequence": 161})
    assert shown["sequence"] == 161
    assert page.do(pass_ms=500, tick=True)["streams"] == 2


def test_where_all_streams_are_taken_the_values_are_asked_for_and_stay(page: Page) -> None:
    page.do(answers=WELL, broken=2)
    for _ in range(3):
        assert page.do(pass_ms=1000, tick=True)["x_mm"] == "10.012"
        assert page.do(broken=2)["x_mm"] == "10.012"
