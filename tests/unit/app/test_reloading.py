from __future__ import annotations

from altd.app.reloading import RELOADED, changed_keys
from altd.config import Config


def test_each_key_that_differs_is_named() -> None:
    old = {
        "unit": {"serial": "A", "kept": 1},
        "http": None,
        "targets": [{"name": "front"}],
        "chain": {"a": 1},
    }
    new = {"unit": {"serial": "B", "kept": 1}, "http": {"port": 1}, "targets": [], "chain": None}
    assert list(changed_keys(old, new)) == ["unit.serial", "http", "targets", "chain"]
    assert list(changed_keys(old, old)) == []


def test_the_tables_that_may_change_are_tables() -> None:
    assert set(RELOADED) < set(Config.model_fields)
