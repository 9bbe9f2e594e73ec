"""The unit as a device of Home Assistant: its discovery message, as Home Assistant 2025.10 documents it.

https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload
"""

from __future__ import annotations

import re
from typing import Any

from altd.config import HttpSettings
from altd.instruments.beam.instrument import QUANTITIES as OF_BEAM
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.instruments.row.measurement import MEASURED
from altd.publish.mqtt.messages import OFFLINE, ONLINE, Topics
from altd.reasons import NOT_FROM_CAMERAS, Reason, Signal
from altd.records import Quantities
from altd.status.unit import UnitFacts
from altd.tcp_port import address_of, is_loopback

EXPIRE_AFTER_S = 5
"""Time without the summary of each second until Home Assistant shows an entity as unavailable."""

STATE_EXPIRE_AFTER_S = 15
"""The same for the state, which is repeated every 10 s."""

MAX_STATE_CHARACTERS = 255
"""Maximum length of a state in Home Assistant."""

NOT_LIVE = (*sorted(NOT_FROM_CAMERAS), Reason.NOT_LIVE, Reason.REHEARSAL)
"""Reasons of a summary that is not of the unit's own cameras."""

_INSTRUMENTS = (*OF_BEAM.of_unit, *OF_PLATE.of_unit, MEASURED)
"""Quantities of all kinds of units, without the places of a row, which each row names itself."""


def discovery_topic(prefix: str, identifier: str) -> str:
    """Topic on which Home Assistant expects the discovery message of a device."""
    return f"{prefix}/device/{identifier}/config"


def page_url(http: HttpSettings | None, own_address: str) -> str | None:
    """Return the URL of the unit's page; None: other computers cannot open it.

    ``own_address`` is the unit's end of the connection to the broker.
    """
    if http is None or not http.port:
        return None
    listening = None if http.host == "localhost" else address_of(http.host)
    if listening is None or is_loopback(listening):
        return None
    address = address_of(own_address) if listening.is_unspecified else listening
    if not http.names and (address is None or address.is_loopback or address.is_link_local):
        return None
    host = http.names[0] if http.names else f"[{address}]" if ":" in str(address) else address
    return f"http{'' if http.certificate is None else 's'}://{host}:{http.port}/"


def discovery_of(  # noqa: PLR0913  facts of the unit
    quantities: Quantities,
    topics: Topics,
    identifier: str,
    serial: str,
    version: str,
    *,
    page: str | None = None,
    is_rehearsal: bool = False,
    product: str = UnitFacts().product,
) -> dict[str, Any]:
    """Return the device-based discovery message, retained at ``discovery_topic``.

    Its entities read summary and state. In rehearsal no number has a ``state_class``, without which Home
    Assistant keeps no statistics. A component with a platform alone is removed: those of other instruments.
    """
    statistics: dict[str, Any] = {} if is_rehearsal else {"state_class": "measurement"}
    diagnostic = {"entity_category": "diagnostic"}
    components: dict[str, dict[str, Any]] = {}
    for quantity in quantities.shown:
        number = statistics | ({"unit_of_measurement": quantity.unit} if quantity.unit else {})
        number["suggested_display_precision"] = quantity.decimals - 1
        components[quantity.key] = _entity(quantity.label, f"value_json.{quantity.key}.mean") | number
        if quantity.has_sigma:
            sigma = _entity(f"{quantity.label} sigma", f"value_json.{quantity.key}.sigma")
            components[f"sigma_{quantity.key}"] = sigma | number | diagnostic
    live = f"value_json.count and not value_json.status | select('in', {list(map(str, NOT_LIVE))}) | list"
    components |= {
        "valid": _entity("valid", "'ON' if value_json.valid_share == 1 else 'OFF'", "binary_sensor"),
        "live": _entity("live", f"'ON' if {live} else 'OFF'", "binary_sensor"),
        "valid_share": _entity(
            "share of valid measurements",
            "100 * value_json.valid_share if value_json.valid_share is number else None",
        )
        | {"unit_of_measurement": "%"}
        | statistics,
        "age_s": _entity("age", "value_json.age_s")
        | {"unit_of_measurement": "s", "device_class": "duration", "suggested_display_precision": 2}
        | statistics
        | diagnostic,
        "status": _entity("reasons", f"(value_json.status | join(', ') or 'none')[:{MAX_STATE_CHARACTERS}]"),
        "state": _entity("state", "value_json.signal")
        | {
            "state_topic": topics.state,
            "device_class": "enum",
            "options": [str(signal) for signal in Signal],
            "expire_after": STATE_EXPIRE_AFTER_S,
        },
    }
    slug = re.sub("[^a-z0-9]+", "_", serial.lower()).strip("_") or identifier
    for key, component in components.items():
        component["unique_id"] = f"{identifier}_{key}"
        component["default_entity_id"] = f"{component['p']}.{slug}_{key}"
    of_others = (name for each in _INSTRUMENTS for name in (each.key, f"sigma_{each.key}"))
    device = {
        "ids": [identifier],
        "name": f"Laser target {serial}",
        "mf": "altd",
        "mdl": product,
        "sn": serial,
        "sw": version,
    }
    return {
        "dev": device | ({} if page is None else {"cu": page}),
        "o": {"name": "altd", "sw": version},
        "cmps": {key: {"p": "sensor"} for key in of_others} | components,
        "state_topic": topics.summary,
        "availability_topic": topics.availability,
        "payload_available": ONLINE,
        "payload_not_available": OFFLINE,
        "qos": 1,
    }


def _entity(name: str, template: str, platform: str = "sensor") -> dict[str, Any]:
    """Return an entity of the summary; without new ones it becomes unavailable."""
    return {
        "p": platform,
        "name": name,
        "value_template": f"{{{{ {template} }}}}",
        "expire_after": EXPIRE_AFTER_S,
    }
