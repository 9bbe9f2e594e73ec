"""The unit as a device of Home Assistant: its discovery message, whose sensors read summary and state."""

from __future__ import annotations

from typing import Any

from altd.publish.mqtt.messages import OFFLINE, ONLINE, Topics
from altd.reasons import Signal
from altd.records import Quantities

EXPIRE_AFTER_S = 5
"""Summaries come each second; a number that none follows for this long is unavailable."""

MAX_STATE_CHARACTERS = 255
"""Of a state in Home Assistant."""


def topic_of(prefix: str, identifier: str) -> str:
    """The topic on which Home Assistant looks for a device."""
    return f"{prefix}/device/{identifier}/config"


def device_of(
    quantities: Quantities, topics: Topics, identifier: str, serial: str, version: str
) -> dict[str, Any]:
    """The device-based discovery message, retained at ``topic_of``."""
    components = {
        quantity.key: _sensor(quantity.label)
        | {
            "value_template": f"{{{{ value_json.{quantity.key}.mean }}}}",
            "unit_of_measurement": quantity.unit,
            "state_class": "measurement",
            "suggested_display_precision": quantity.decimals - 1,
            "expire_after": EXPIRE_AFTER_S,
        }
        for quantity in quantities.shown
    }
    components["valid_share"] = _sensor("valid") | {
        "value_template": "{{ 100 * value_json.valid_share if value_json.valid_share is number else None }}",
        "unit_of_measurement": "%",
        "state_class": "measurement",
        "expire_after": EXPIRE_AFTER_S,
    }
    components["status"] = _sensor("reasons") | {
        "value_template": f"{{{{ (value_json.status | join(', ') or 'none')[:{MAX_STATE_CHARACTERS}] }}}}",
        "expire_after": EXPIRE_AFTER_S,
    }
    components["state"] = _sensor("state") | {
        "state_topic": topics.state,
        "value_template": "{{ value_json.signal }}",
        "device_class": "enum",
        "options": [str(signal) for signal in Signal],
    }
    for key, component in components.items():
        component["unique_id"] = f"{identifier}_{key}"
    return {
        "dev": {
            "ids": [identifier],
            "name": f"Laser target {serial}",
            "mdl": "Active Laser Target",
            "sn": serial,
            "sw": version,
        },
        "o": {"name": "altd", "sw": version},
        "cmps": components,
        "state_topic": topics.summary,
        "availability_topic": topics.availability,
        "payload_available": ONLINE,
        "payload_not_available": OFFLINE,
        "qos": 1,
    }


def _sensor(name: str) -> dict[str, Any]:
    return {"p": "sensor", "name": name}
