"""What is wrong with a config, in one line."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError


def first_fault(error: ValidationError, document: dict[str, Any]) -> str:
    """The first of the faults, with its key."""
    faults = error.errors(include_url=False)
    first = faults[0]
    keys = _keys(first["loc"], document)
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "unknown key"
    elif first["type"] == "union_tag_invalid":
        keys.append("driver")
        message = f"{first['ctx']['tag']!r} is none of {first['ctx']['expected_tags']}"
    elif first["type"] == "union_tag_not_found":
        keys.append("driver")
        message = "Field required"
    elif isinstance(first["input"], int | float):
        message += f", not {first['input']}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{'.'.join(keys)}: {message}{more}" if keys else f"{message}{more}"


def _keys(location: tuple[int | str, ...], document: Any) -> list[str]:
    """Where in the file; pydantic puts the driver's name, which is no key, between a table and its key."""
    keys: list[str] = []
    for part in location[:-1]:
        table = document if isinstance(document, dict) else {}
        if part in table or isinstance(document, list):
            document = document[part]
        elif part == table.get("driver"):
            continue
        keys.append(str(part))
    return [*keys, *map(str, location[-1:])]
