"""Changes since the last start: settings, calibration, program."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from typing import Any

from altd.history.batch import Notice
from altd.history.schema import ForeignFileError
from altd.status.event_log import EventKind

_KINDS = {
    "config": (EventKind.CONFIG, "the settings have changed"),
    "calibration": (EventKind.CALIBRATION, "the calibration has changed"),
    "version": (EventKind.VERSION, "the program has changed"),
}
_MAX_CHANGES = 10
_MAX_CHARACTERS = 60


def check_unit(connection: sqlite3.Connection, facts: Mapping[str, str]) -> None:
    """Raise ForeignFileError for a history of another unit: what that measured is none of this one's past."""
    found = connection.execute("SELECT value FROM facts WHERE name = 'serial'").fetchone()
    serial = facts.get("serial")
    if found is not None and serial is not None and found[0] != serial:
        raise ForeignFileError(f"is of unit {found[0]!r}, and this one is {serial!r}")


def changed_facts(connection: sqlite3.Connection, facts: Mapping[str, str]) -> list[Notice]:
    """Compare with what the file holds, and put the new ones there; inside of a transaction."""
    before = dict(connection.execute("SELECT name, value FROM facts"))
    notices = []
    for name, value in facts.items():
        connection.execute("INSERT OR REPLACE INTO facts VALUES (?, ?)", (name, value))
        if name in before and before[name] != value and name in _KINDS:
            kind, text = _KINDS[name]
            notices.append(Notice(kind, text, _difference(before[name], value)))
    return notices


def _difference(before: str, after: str) -> dict[str, object]:
    """The keys of a document that changed, or the two texts."""
    try:
        old, new = (dict(_leaves(json.loads(text), "")) for text in (before, after))
    except (ValueError, TypeError, RecursionError):
        return {"before": _shown(before), "after": _shown(after)}
    changed = [key for key in {**old, **new} if old.get(key, "") != new.get(key, "")]
    shown: dict[str, object] = {
        key: [_shown(old.get(key, "")), _shown(new.get(key, ""))] for key in changed[:_MAX_CHANGES]
    }
    if len(changed) > _MAX_CHANGES:
        shown["more"] = len(changed) - _MAX_CHANGES
    return {"changed": shown}


def _leaves(node: Any, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(node, dict):
        for key, below in node.items():
            yield from _leaves(below, f"{place}.{key}" if place else key)
    elif isinstance(node, list):
        for number, below in enumerate(node):
            yield from _leaves(below, f"{place}.{number}")
    else:
        yield place, json.dumps(node)


def _shown(text: str) -> str:
    return text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]}…"
