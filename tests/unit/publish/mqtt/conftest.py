"""Times that no test waits for."""

import pytest

from altd.publish.mqtt import connecting, edge_node
from altd.runtime import supervision


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    for place, name, value in (
        (connecting, "INTERVAL_S", 0.02),
        (connecting, "MAX_JITTER_S", 0.0),
        (edge_node, "REBIRTH_INTERVAL_S", 0.1),
        (supervision, "MIN_BACKOFF_S", 0.01),
        (supervision, "MAX_BACKOFF_S", 0.01),
    ):
        monkeypatch.setattr(place, name, value)
