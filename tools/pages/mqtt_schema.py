"""``docs/mqtt.schema.json`` from the payloads' models."""

import json

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.mqtt.messages import schema_of


def page() -> str:
    """JSON Schema of all payloads."""
    return json.dumps(schema_of(QUANTITIES), indent=1) + "\n"
