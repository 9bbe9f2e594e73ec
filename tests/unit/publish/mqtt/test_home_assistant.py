"""The discovery message, by hand from the documentation of Home Assistant, its templates with Jinja."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
from jinja2.sandbox import ImmutableSandboxedEnvironment
from support.clock import FakeClock
from support.measurements import measurement
from support.mqtt import ChosenBroker, PublishingUnit

from altd.config import HttpSettings
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.instruments.row.measurement import quantities_of
from altd.publish.mqtt import publisher
from altd.publish.mqtt.home_assistant import discovery_of, discovery_topic, page_url
from altd.publish.mqtt.messages import Topics, summary_of
from altd.reasons import Reason
from altd.records import Fault, Measurement, Quantities
from altd.status.unit import PublishedUnit

ABOUT = Topics.of("altd", "ALT-0007"), "altd_1e4b2d8e", "ALT-0007", "0.1.0"


def components(quantities: Quantities = QUANTITIES, **more: Any) -> Mapping[str, dict[str, Any]]:
    """Those that are not removed."""
    every = discovery_of(quantities, *ABOUT, **more)["cmps"]
    return {key: component for key, component in every.items() if component != {"p": "sensor"}}


def test_a_device_has_what_discovery_requires() -> None:
    device = discovery_of(QUANTITIES, *ABOUT, page="http://10.0.0.7:8080/")
    assert (device["dev"]["ids"], device["dev"]["name"]) == (["altd_1e4b2d8e"], "Laser target ALT-0007")
    assert (device["dev"]["mf"], device["dev"]["cu"]) == ("altd", "http://10.0.0.7:8080/")
    assert device["o"]["name"] == "altd"
    assert device["availability_topic"] == "altd/ALT-0007/availability"
    assert discovery_topic("homeassistant", "altd_1e4b2d8e") == "homeassistant/device/altd_1e4b2d8e/config"


@pytest.mark.parametrize("quantities", [QUANTITIES, OF_PLATE, quantities_of(["t1_b", "t2"])])
def test_every_component_expires_and_has_a_name_of_its_own(quantities: Quantities) -> None:
    found = components(quantities)
    for key, component in found.items():
        assert 0 < component["expire_after"] <= 15, f"an old value of {key} would stay"
        assert component["unique_id"] == f"altd_1e4b2d8e_{key}"
        assert component["default_entity_id"] == f"{component['p']}.alt_0007_{key}"
    assert len({component["name"] for component in found.values()}) == len(found)
    assert {key for key, each in found.items() if each["p"] == "binary_sensor"} == {"valid", "live"}
    shown = {each.key for each in quantities.shown}
    assert found.keys() >= shown | {f"sigma_{each.key}" for each in quantities.shown if each.has_sigma}
    assert found["age_s"]["device_class"] == "duration"


def test_components_of_another_instrument_or_sensor_are_removed() -> None:
    """A component with its platform alone is removed, one that is omitted stays."""
    with_roll = QUANTITIES.with_sensor("roll_deg")
    for before, now in ((with_roll, QUANTITIES), (with_roll, OF_PLATE), (OF_PLATE, QUANTITIES)):
        gone = components(before).keys() - components(now).keys()
        sent = discovery_of(now, *ABOUT)["cmps"]
        assert gone
        assert [sent.get(key) for key in gone] == [{"p": "sensor"}] * len(gone)


def test_no_value_of_a_rehearsal_enters_statistics() -> None:
    assert any("state_class" in component for component in components().values())
    assert not any("state_class" in component for component in components(is_rehearsal=True).values())


LIVE_VALID = {"x_mm": "10.012", "sigma_x_mm": "0.004", "valid": "ON", "live": "ON", "valid_share": "100.0"}


@pytest.mark.parametrize(
    ("measurements", "shown"),
    [
        ([measurement()], LIVE_VALID | {"status": "none"}),
        ([measurement(), measurement(161, 1, Reason.STALE)], {"valid": "OFF", "valid_share": "50.0"}),
        (
            [replace(measurement(), status=(Fault(Reason.PLAYBACK), Fault(Reason.REHEARSAL)))],
            {"valid": "ON", "live": "OFF", "status": "playback, rehearsal"},
        ),
        ([replace(measurement(), status=(Fault(Reason.SIMULATED),))], {"live": "OFF"}),
        ([measurement(161, 1, Reason.NOT_LIVE)], {"x_mm": "None", "live": "OFF", "valid": "OFF"}),
        ([], {"valid": "OFF", "live": "OFF", "x_mm": "None", "valid_share": "None", "age_s": "None"}),
    ],
)
def test_what_its_templates_show_of_a_summary(
    measurements: list[Measurement], shown: dict[str, str], published: PublishedUnit, clock: FakeClock
) -> None:
    summary = {**summary_of(measurements, published.view()), "age_s": None}
    environment = ImmutableSandboxedEnvironment()
    found = {
        key: environment.from_string(components()[key]["value_template"]).render(value_json=summary)
        for key in shown
    }
    assert found == shown


@pytest.mark.parametrize(
    ("settings", "url"),
    [
        (None, None),
        ({}, "http://10.0.0.7:8080/"),
        ({"host": "localhost"}, None),
        ({"host": "127.0.0.1"}, None),
        ({"host": "192.168.1.7", "port": 80}, "http://192.168.1.7:80/"),
        ({"host": "fd00::7"}, "http://[fd00::7]:8080/"),
        ({"names": ("alt-0007.plant",)}, "http://alt-0007.plant:8080/"),
        ({"certificate": "c.pem", "key": "k.pem"}, "https://10.0.0.7:8080/"),
    ],
)
def test_the_url_of_the_page_is_one_that_other_computers_can_open(
    settings: dict[str, Any] | None, url: str | None
) -> None:
    http = None if settings is None else HttpSettings(**settings)
    assert page_url(http, "10.0.0.7") == url
    if settings == {}:
        assert page_url(http, "127.0.0.1") is page_url(http, "fe80::1%eth0") is page_url(http, "") is None


async def test_the_announcement_expires_and_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the device of a unit that changed to Sparkplug would stay."""
    for name in ("REFRESH_INTERVAL_S", "DISCOVERY_INTERVAL_S"):
        monkeypatch.setattr(publisher, name, 0.0)
    async with (
        ChosenBroker() as broker,
        PublishingUnit.made(broker.port, home_assistant="homeassistant").running(),
    ):
        first, again = await broker.until("config"), await broker.until("config")
    assert (first.retain, first.expiry_s) == (True, 3600)
    assert json.loads(first.payload) == json.loads(again.payload)
