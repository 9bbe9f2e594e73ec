"""The OpenAPI document: a foreign validator takes it, and each answer is what it says."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator
from support.clock import FakeClock
from support.measurements import changed, measured

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http import publisher
from altd.publish.http.openapi import api_page_of, document_of
from altd.publish.http.paths import PATHS
from altd.reasons import Reason
from altd.records import Fault, Finding, Measurement, Value
from altd.records.sensors import Quality, SensorValue
from altd.selfcheck.records import LedState, SelfCheck, Similarity, TargetDrift, Verdict
from altd.status.board import Board
from altd.status.health import Health, State
from altd.status.services import SelfCheckReport
from altd.status.state import UnitState
from altd.status.target_area import TargetArea
from altd.status.unit import PublishedUnit

from .conftest import DOCUMENT, Served, Unit, fits, served_with


def test_a_foreign_validator_takes_the_document() -> None:
    assert list(OpenAPIV31SpecValidator(DOCUMENT).iter_errors()) == []
    assert DOCUMENT["openapi"].startswith("3.1")


def test_every_path_but_the_old_ones_is_in_it_with_its_methods() -> None:
    served = {path.path: set(map(str.lower, path.operations)) for path in PATHS if not path.is_old}
    told = {path: set(operations) - {"head"} for path, operations in DOCUMENT["paths"].items()}
    assert told == served


def test_each_old_path_stays_and_answers_as_its_new_one() -> None:
    operations = {path.path: path.operations for path in PATHS}
    for old in ("measurement", "status", "self-check"):
        assert operations[f"/api/{old}"] is operations[f"/api/v1/{old}"]


async def test_it_is_made_once_for_all_interfaces_and_requests(
    served: Served, published: PublishedUnit, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[str]()

    def observed(*arguments: Any) -> dict[str, Any]:
        made.append(arguments[2])
        return document_of(*arguments)

    monkeypatch.setattr(publisher, "document_of", observed)
    published.facts = published.facts.model_copy(update={"version": "of this test"})
    async with served() as unit, served() as other:
        for each in (unit, other, unit):
            told = (await each.ask("/api/v1/openapi.json")).json
            assert told == document_of(PATHS, QUANTITIES, "of this test")
            assert (await each.ask("/api/v1/")).status == 200
    assert made == ["of this test"]


async def test_measurements_of_every_kind_are_what_the_document_says(
    unit: Unit, board: Board, measured: Measurement
) -> None:
    invalid = changed(measured, None, status=(Fault(Reason.SPOT_MISSING, "front"),))
    timeless = changed(measured, None, {"front": None, "rear": None})
    fits(DOCUMENT, "/api/v1/measurement", await unit.ask("/api/v1/measurement"))
    for each in (measured, invalid, timeless):
        board.publish(each)
        fits(DOCUMENT, "/api/v1/measurement", await unit.ask("/api/v1/measurement"))


async def test_a_unit_with_an_inclinometer_has_a_document_of_its_own(
    health: Health, clock: FakeClock
) -> None:
    quantities = QUANTITIES.with_sensor("roll_deg")
    said = SensorValue(Quality.GOOD, "", 0.5, 0.01, clock.now_ns, 0.2, clock.now_ns + 10**9)
    board = Board(clock, 1.0, quantities, sense=lambda _: Finding(from_sensors={"roll_deg": said}))
    board.publish(measured(quantities=quantities))
    async with served_with(PublishedUnit(board, health), None) as unit:
        document = (await unit.ask("/api/v1/openapi.json")).json
        shown = fits(document, "/api/v1/measurement", await unit.ask("/api/v1/measurement"))
    assert shown["sigma"]["roll_deg"] == 0.01
    assert "roll_deg" in document["components"]["schemas"]["Sigma"]["properties"]


async def test_the_status_is_what_the_document_says_well_and_ill(
    unit: Unit,
    board: Board,
    health: Health,
    published: PublishedUnit,
    clock: FakeClock,
    measured: Measurement,
) -> None:
    state = UnitState(board, health, clock)
    fits(DOCUMENT, "/api/v1/status", await unit.ask("/api/v1/status"))  # the state is not known yet
    published.state = state.read
    health.component("camera front").observe({"fps": 20.0, "driver": "v4l2", "celsius": None})
    health.component("camera front").set_state(State.FAILED, "no such device")
    board.publish(measured)
    clock.now_ns += 3_000_000_000
    shown = fits(DOCUMENT, "/api/v1/status", await unit.ask("/api/v1/status"))
    assert {cause["code"] for cause in shown["state"]["causes"]} >= {"camera_failed", "stale"}


async def test_what_self_checks_say_is_what_the_document_says(unit: Unit, published: PublishedUnit) -> None:
    similarity = Similarity((376.0, 240.0), (0.1, -0.2), 0.01, 12.0, np.eye(4), 200.0)
    drift = TargetDrift("front", 8, 7, (LedState.USED, LedState.DARK), ((1.0, 2.0),), similarity, 0.05, 1.5)
    effects = {"x_mm": Value(0.01, 0.002), "yaw_deg": Value(0.001, 0.0002)}
    checks = (
        SelfCheck(Verdict.SUSPECT, {"front": drift}, effects, ("front has moved",)),
        SelfCheck(Verdict.UNKNOWN, {"front": TargetDrift("front", 8, 0, ())}, {}, ("no LED was seen",)),
    )
    none = fits(DOCUMENT, "/api/v1/self-check", await unit.ask("/api/v1/self-check"))
    for number, check in enumerate(checks, 1):
        published.self_check.publish(
            SelfCheckReport(number, replace(check, notes=("a note",)), "request", None, 3)
        )
        shown = fits(DOCUMENT, "/api/v1/self-check", await unit.ask("/api/v1/self-check"))
        assert shown["number"] == number
    assert none["verdict"] is None


@pytest.mark.parametrize("path", ["/api/v1/measurement", "/readyz"])
async def test_errors_have_the_one_shape(unit: Unit, path: str) -> None:
    answer = await unit.ask(path)
    assert answer.status == 503
    assert set(fits(DOCUMENT, path, answer)) <= {"error", "status"}


async def test_all_methods_of_a_path_are_named_where_another_is_asked_for(unit: Unit) -> None:
    answer = await unit.ask("/api/v1/self-check", "DELETE")
    assert answer.status == 405
    assert {method.strip() for method in answer.headers["allow"].split(",")} == {"GET", "HEAD", "POST"}


class Tags(HTMLParser):
    """Which elements and attributes a page has, and whether all that it opens is closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.seen: set[str] = set()
        self.attributes: set[str] = set()
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag not in ("meta", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


async def test_the_page_of_the_api_runs_nothing_and_loads_nothing(unit: Unit) -> None:
    answer = await unit.ask("/api/v1/")
    page = answer.body.decode()
    tags = Tags(page)
    assert tags.open == []
    assert not tags.seen & {"script", "iframe", "img", "object", "form"}
    assert not any(name.startswith("on") or name == "src" for name in tags.attributes)
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "script" not in answer.headers["content-security-policy"]
    assert "://" not in page
    links, places = set(re.findall(r'href="#([^"]+)"', page)), set(re.findall(r'id="([^"]+)"', page))
    assert links <= places
    for path in DOCUMENT["paths"]:
        assert f">{path}<" in page


def test_no_text_of_the_document_becomes_html() -> None:
    evil = json.loads(json.dumps(DOCUMENT).replace("Active Laser Target", "<script>alert(1)</script>"))
    evil["components"]["schemas"]["Error"]["description"] = "`<img src=x onerror=alert(1)>`"
    assert not Tags(api_page_of(evil)).seen & {"script", "img"}


async def test_the_targets_are_what_the_document_says(unit: Unit, published: PublishedUnit) -> None:
    published.targets = (TargetArea("front", 0.0, ((-70.0, -55.0), (70.0, -55.0), (0.0, 55.5))),)
    told = fits(DOCUMENT, "/api/v1/targets", await unit.ask("/api/v1/targets"))
    assert told["targets"] == [
        {"name": "front", "z_mm": 0.0, "valid_mm": [[-70.0, -55.0], [70.0, -55.0], [0.0, 55.5]]}
    ]
