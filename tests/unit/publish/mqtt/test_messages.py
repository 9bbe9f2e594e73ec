"""Topics and payloads, by hand and by formula."""

import asyncio
import json
import math
import re
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry
from referencing.jsonschema import DRAFT202012
from support.clock import FakeClock
from support.history import ABOUT, MAX_BYTES, START_S, batch, sample
from support.measurements import BEAM, changed, measurement
from support.mqtt import ChosenBroker, PublishingUnit
from support.places import DOCS
from support.status_fixtures import figures_of

from altd.history.history import History
from altd.history.outbox import Outbox
from altd.history.store import Store
from altd.publish.modbus.responder import objects_of
from altd.publish.mqtt.home_assistant import discovery_of
from altd.publish.mqtt.messages import Topics, birth_of, schema_of, summary_of
from altd.publish.mqtt.sparkplug import measurement_metrics
from altd.publish.serial.commands import identification
from altd.reasons import Reason
from altd.records import Measurement
from altd.records.spots import Motion
from altd.status.board import Board
from altd.status.health import Health
from altd.status.measurement_json import checked_line, with_proof
from altd.status.models import status_of
from altd.status.outbox import acknowledgement_of
from altd.status.proof import Stamps
from altd.status.unit import PublishedUnit


def test_each_payload_fits_the_schema_of_its_topic_and_no_other(
    board: Board, health: Health, published: PublishedUnit, clock: FakeClock
) -> None:
    board.publish(measurement())
    stamps = Stamps(board, "mqtt")
    published.calibration = figures_of(created="2026-11-02", checksum="1")
    payloads = {
        "birth": with_proof(birth_of(published.view()), board, stamps.next()),
        "summary": with_proof(summary_of([measurement()], published.view()), board, stamps.next()),
        "measurement": checked_line(board, measurement(), stamps.next()),
    }
    schema = schema_of(board.quantities)
    assert schema["topics"].keys() == payloads.keys() | {"state"}
    assert not Draft202012Validator(schema).is_valid({})
    for topic, line in payloads.items():
        document = json.loads(line)
        Draft202012Validator(schema).validate(document)
        for other, reference in schema["topics"].items():
            of_topic = Draft202012Validator({**reference, "$defs": schema["$defs"]})
            assert of_topic.is_valid(document) is (topic == other)


async def test_what_a_unit_publishes_is_what_the_asyncapi_document_says(tmp_path: Path) -> None:
    """The document has what AsyncAPI 3.0 requires, and no reference of it leads nowhere."""
    names = ("mqtt.asyncapi.json", "mqtt.schema.json")
    read = [(name, json.loads((DOCS / name).read_text())) for name in names]
    registry = Registry().with_resources((name, DRAFT202012.create_resource(each)) for name, each in read)
    document: dict[str, Any] = read[0][1]
    for reference in re.findall(r'"\$ref": "([^"]+)"', json.dumps(document)):
        registry.resolver(names[0]).lookup(reference)
    assert document["asyncapi"] == "3.0.0"
    assert document["info"].keys() >= {"title", "version"}
    assert [each["channel"]["$ref"] for each in document["operations"].values()] == [
        f"#/channels/{name}" for name in document["channels"]
    ]

    def check(name: str, payload: str) -> None:
        is_json = document["channels"][name]["messages"][name]["contentType"] == "application/json"
        schema = {"$ref": f"{names[0]}#/channels/{name}/messages/{name}/payload"}
        Draft202012Validator(schema, registry=registry).validate(json.loads(payload) if is_json else payload)

    check("ack", acknowledgement_of("ALT-0007", "0" * 16, 1))
    store = Store(tmp_path / "history.db", MAX_BYTES, ABOUT, has_outbox=True)
    history = History(tmp_path / "history.db")
    outbox = Outbox(history)
    outbox.mark = store.write(batch(START_S + 5, [sample(START_S + 0.1, 10.0)])).outbox
    values = {"topic": "plant/altd", "serial": "ALT-0007", "prefix": "ha", "identifier": "altd_1e4b2d8e"}
    topics = {each["address"].format(**values): name for name, each in document["channels"].items()}
    sent = {name for name, each in document["operations"].items() if each["action"] == "send"}
    async with ChosenBroker() as broker:
        settings = {"topic": values["topic"], "every_measurement": True, "home_assistant": values["prefix"]}
        unit = PublishingUnit.made(broker.port, outbox=outbox, **settings)
        unit.measure(1)
        async with unit.running():
            while sent:
                told = await asyncio.wait_for(broker.published.get(), 20.0)
                name = topics[told.topic]
                check(name, told.payload)
                binding = document["operations"][name]["bindings"]["mqtt"]
                assert (told.qos, told.retain) == (binding["qos"], binding["retain"])
                assert told.expiry_s == binding.get("messageExpiryInterval")
                sent.discard(name)
    await history.end()
    store.end(None)


@pytest.mark.parametrize(
    ("serial", "level"),
    [
        ("ALT-0007", "ALT-0007"),
        ("A/1 +#", "A%2F1%20%2B%23"),
        ("ä\u2028", "%C3%A4%E2%80%A8"),
        ("A%2F1", "A%252F1"),
    ],
)
def test_a_serial_number_is_one_level_of_a_topic_whatever_is_in_it(serial: str, level: str) -> None:
    assert Topics.of("plant/altd", serial).state == f"plant/altd/{level}/state"


def measured(*x_mm: float) -> list[Measurement]:
    beams = [replace(BEAM, x_mm=x, sigma_x_mm=0.001 * n) for n, x in enumerate(x_mm, 1)]
    return [changed(measurement(100 + n), beam) for n, beam in enumerate(beams)]


def test_a_summary_has_mean_extremes_and_sigma_of_the_valid_measurements(
    published: PublishedUnit, clock: FakeClock
) -> None:
    x_mm = (1.0, 4.0, 2.5)
    summary = summary_of([*measured(*x_mm), measurement(103, 1, Reason.STALE)], published.view())
    assert summary["x_mm"] == {
        "mean": statistics.mean(x_mm),
        "min": 1.0,
        "max": 4.0,
        "sigma": round(math.sqrt((1 + 4 + 9) / 3) * 1e-3, 4),
        "sigma_now": None,  # its motion is not known
    }
    assert (summary["count"], summary["valid_share"], summary["status"]) == (4, 0.75, ["stale"])
    assert (summary["first"]["sequence"], summary["last"]["sequence"]) == (100, 103)
    assert [key for key in summary if isinstance(summary[key], dict)][2:] == [
        "x_mm",
        "y_mm",
        "yaw_deg",
        "pitch_deg",
    ]


def test_sigma_now_is_that_of_the_last_measurement_at_sending(
    board: Board, published: PublishedUnit, clock: FakeClock
) -> None:
    """2 mm/s beside a sigma of 0.004 mm, 0.5 s after the middle of the exposures."""
    motion = Motion(2.0, 0.01, 0.0, 0.0, 0.475, 0.083, probable_rate=2.0, acceleration=0.0)
    moving = replace(measurement(), motions={"x_mm": motion}, t_ns=clock.now_ns)
    board.publish(moving)
    clock.now_ns += 500_000_000
    sigma = math.hypot(moving.sigma("x_mm") or 0.0, 1.0)
    assert summary_of([moving], published.view())["x_mm"]["sigma_now"] == pytest.approx(sigma, abs=1e-3)
    metrics = {each.name: each.value for each in measurement_metrics(moving, board, clock)}
    assert metrics["sigma_now/x_mm"] == pytest.approx(sigma, abs=1e-3)
    assert metrics["sigma_now/y_mm"] is None


NOTHING = dict.fromkeys(("mean", "min", "max", "sigma", "sigma_now"))


def test_a_summary_without_a_valid_measurement_has_no_number(
    board: Board, published: PublishedUnit, clock: FakeClock
) -> None:
    board.publish(measurement())  # that of before is still on the board
    reasons = (Reason.STALE, Reason.SIMULATED)
    summary = summary_of([measurement(161, 1, *reasons)] * 2, published.view())
    assert summary["x_mm"] == summary["pitch_deg"] == NOTHING
    assert (summary["valid_share"], summary["status"]) == (0.0, ["stale", "simulated"])


def test_a_second_without_a_measurement_has_no_number_of_an_earlier_one(
    board: Board, published: PublishedUnit, clock: FakeClock
) -> None:
    assert summary_of([], published.view())["status"] == ["warming_up"]
    board.publish(measurement(160, clock.now_ns))
    clock.now_ns += 2_000_000_000
    summary = summary_of([], published.view())
    assert summary["x_mm"] == NOTHING
    assert (summary["count"], summary["valid_share"], summary["first"]) == (0, None, None)
    assert summary["status"] == ["stale"]


def test_a_birth_names_unit_calibration_and_quantities(
    board: Board, health: Health, published: PublishedUnit, clock: FakeClock
) -> None:
    published.calibration = figures_of("2026-11-02", "sha256:1", simulated=True)
    birth = birth_of(published.view())
    assert (birth["serial"], birth["version"]) == ("ALT-0007", "0.1.0")
    assert birth["calibration"] == {"created": "2026-11-02", "checksum": "sha256:1", "simulated": True}
    assert birth["quantities"]["yaw_deg"]["unit"] == "°"


def test_every_identification_tells_a_desk_unit_from_that_of_a_machine(
    board: Board, published: PublishedUnit
) -> None:
    def found() -> tuple[object, ...]:
        view = published.view()
        about = Topics.of("altd", "D-1"), "altd_1", "D-1", "0.1.0"
        device = discovery_of(view.quantities, *about, product=view.facts.product)
        return (
            status_of(view).as_object().get("kind"),
            birth_of(view).get("kind"),
            device["dev"]["mdl"],
            objects_of(view)[4].decode(),
            identification(view.facts).split(",")[1],
        )

    name = "Active Laser Target"
    assert found() == (None, None, name, name, name)
    published.facts = published.facts.model_copy(update={"kind": "desk"})
    of_desk = f"{name} on a desk"
    assert found() == ("desk", "desk", of_desk, of_desk, of_desk)
    message = json.loads(with_proof(birth_of(published.view()), board, Stamps(board, "mqtt").next()))
    Draft202012Validator(schema_of(board.quantities)).validate(message)
