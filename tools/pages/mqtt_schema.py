"""``docs/mqtt.schema.json`` and ``docs/mqtt.asyncapi.json`` from the payloads' models and the topics."""

import json
import re
from typing import Any, NamedTuple

from pydantic.json_schema import models_json_schema

from altd import __version__
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.mqtt.broker import KEEP_ALIVE_S
from altd.publish.mqtt.home_assistant import discovery_topic
from altd.publish.mqtt.messages import OFFLINE, ONLINE, schema_of
from altd.publish.mqtt.outbox import BATCH_EXPIRY_S
from altd.publish.mqtt.publisher import (
    DISCOVERY_EXPIRY_S,
    NUMBERS_EXPIRY_S,
    REFRESH_INTERVAL_S,
    RETAINED_EXPIRY_S,
)
from altd.status.outbox import Acknowledgement, Batch


class Channel(NamedTuple):
    """The messages on a topic; ``expiry_s`` None: they do not expire."""

    content: str
    when: str
    is_retained: bool
    expiry_s: int | None


_REFRESH = f"each {REFRESH_INTERVAL_S:g} s"
_WITH_OUTBOX = "with `store_and_forward = true`"
TOPICS = {
    "availability": Channel(
        f"`{ONLINE}`, `{OFFLINE}`", f"at each connection, {_REFRESH}", True, RETAINED_EXPIRY_S
    ),
    "birth": Channel("identity of the unit", "at each connection", True, None),
    "state": Channel(
        "NE 107 signal and its causes", f"when it changes, and {_REFRESH}", True, RETAINED_EXPIRY_S
    ),
    "summary": Channel("the measurements of a second", "each second", False, NUMBERS_EXPIRY_S),
    "measurement": Channel("one measurement", "with `every_measurement = true`", False, NUMBERS_EXPIRY_S),
    "outbox": Channel("[batches](fleet.md#messages)", _WITH_OUTBOX, False, BATCH_EXPIRY_S),
}
"""Topics that a unit publishes, by their last level."""

_CHANNELS = TOPICS | {
    "discovery": Channel("device of Home Assistant", "with `home_assistant`", True, DISCOVERY_EXPIRY_S),
    "ack": Channel("acknowledgement of the ingest", _WITH_OUTBOX, True, None),
}
_PARAMETERS = {
    "topic": {"description": "`topic` of `[mqtt]`.", "default": "altd"},
    "serial": {"description": "Serial number of the unit, percent-encoded."},
    "prefix": {"description": "`home_assistant` of `[mqtt]`."},
    "identifier": {"description": "Client identifier: `altd_` and `unit` of the payloads in small letters."},
}
_BINDING = {"qos": 1, "bindingVersion": "0.2.0"}


def page() -> str:
    """JSON Schema of all payloads."""
    return json.dumps(schema_of(QUANTITIES), indent=1) + "\n"


def asyncapi() -> str:
    """AsyncAPI document of all topics but those of Sparkplug; the unit is the application."""
    _, schemas = models_json_schema(
        [(Batch, "validation"), (Acknowledgement, "validation")], ref_template="#/components/schemas/{model}"
    )
    of_topic = {name: schema["$ref"] for name, schema in schema_of(QUANTITIES)["topics"].items()}
    payloads: dict[str, dict[str, Any]] = {
        "availability": {"type": "string", "enum": [ONLINE, OFFLINE]},
        **{name: {"$ref": f"mqtt.schema.json{reference}"} for name, reference in of_topic.items()},
        "outbox": {"$ref": "#/components/schemas/Batch"},
        "discovery": {"type": "object", "required": ["dev", "o", "cmps"]},
        "ack": {"$ref": "#/components/schemas/Acknowledgement"},
    }
    will = {"topic": _address("availability"), "message": OFFLINE, "qos": 1, "retain": True}
    session = {"cleanSession": True, "keepAlive": KEEP_ALIVE_S, "lastWill": will, "bindingVersion": "0.2.0"}
    broker = {"host": "{host}", "protocol": "mqtt", "protocolVersion": "5.0", "bindings": {"mqtt": session}}
    document = {
        "asyncapi": "3.0.0",
        "info": {"title": "Active Laser Target", "version": __version__, "description": "See mqtt.md."},
        "servers": {"broker": broker | {"variables": {"host": {"description": "`host` of `[mqtt]`."}}}},
        "channels": {name: _channel(name, payloads[name]) for name in _CHANNELS},
        "operations": {name: _operation(name) for name in _CHANNELS},
        "components": {"schemas": schemas["$defs"]},
    }
    return json.dumps(document, indent=1) + "\n"


def _address(name: str) -> str:
    return (
        discovery_topic("{prefix}", "{identifier}") if name == "discovery" else f"{{topic}}/{{serial}}/{name}"
    )


def _channel(name: str, payload: dict[str, Any]) -> dict[str, Any]:
    kind, about = "text/plain" if name == "availability" else "application/json", _CHANNELS[name]
    return {
        "address": _address(name),
        "description": f"{about.content}, {about.when}",
        "parameters": {key: _PARAMETERS[key] for key in re.findall(r"\{(\w+)\}", _address(name))},
        "messages": {name: {"contentType": kind, "payload": payload}},
    }


def _operation(name: str) -> dict[str, Any]:
    is_sent, about = name != "ack", _CHANNELS[name]
    expiry = {} if about.expiry_s is None else {"messageExpiryInterval": about.expiry_s}
    binding = _BINDING | ({"retain": about.is_retained} | expiry if is_sent else {})
    operation = {"action": "send" if is_sent else "receive", "channel": {"$ref": f"#/channels/{name}"}}
    return operation | {"bindings": {"mqtt": binding}}
