"""Values that a key of ``altd.toml`` accepts, from the models: for the settings page and for errors."""

from __future__ import annotations

import types
from collections.abc import Callable
from datetime import date
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from altd.config.places import Keys
from altd.files.table import NAME_PATTERN, Table

_TYPE_NAMES = {bool: "true or false", int: "whole number", float: "number", str: "text", date: "date"}


def expected(annotation: Any, metadata: list[Any], quoted: Callable[[object], str]) -> str:
    """Return a type in TOML's terms, with its limits; ``quoted`` formats a value of a choice."""
    annotation, metadata = _plain(annotation, metadata)
    if get_origin(annotation) is Literal:
        return " or ".join(quoted(value) for value in get_args(annotation))
    limits = {type(limit).__name__: limit for part in metadata for limit in _parts(part)}
    if get_origin(annotation) is dict or (isinstance(annotation, type) and issubclass(annotation, Table)):
        return "table"
    shortest, longest = (_size(limits, kind) for kind in ("MinLen", "MaxLen"))
    if get_origin(annotation) is tuple:
        return f"list of {shortest} or more" if shortest else "list"
    word = (
        _TYPE_NAMES.get(annotation, "path") if isinstance(annotation, type) else "number, text, true or false"
    )
    if any(getattr(limit, "pattern", None) == NAME_PATTERN for limit in limits.values()):
        word += " of small letters, digits and _, a letter first"
    if longest:
        word += f", {shortest or 0} to {longest} characters"
    low = _limit(limits, "Ge", "from {}") or _limit(limits, "Gt", "above {}")
    high = _limit(limits, "Le", "to {}") or _limit(limits, "Lt", "to below {}")
    return " ".join(part for part in (word, low, high) if part)


def field_at(keys: Keys, document: Any, annotation: Any) -> tuple[Any, list[Any]] | None:
    """Return type and limits of a key of a document that has type ``annotation``; None: no such key."""
    metadata: list[Any] = []
    for key in keys:
        step = _step(annotation, key, document)
        if step is None:
            return None
        annotation, metadata = step
        try:
            document = document[key]
        except (KeyError, IndexError, TypeError):
            document = None
    return annotation, metadata


def tables_at(annotation: Any, table: Any) -> list[type[Table]]:
    """Return a table's possible models: if the value of its tag is known, the model of that value."""
    models = [option for option, _ in _options(annotation) if _is_table(option)]
    tag = tag_at(annotation)
    value = table.get(tag) if isinstance(table, dict) else None
    fitting = [model for model in models if value in tags_of(model, tag)]
    return fitting or models


def tag_at(annotation: Any) -> str:
    """Return the key that selects a table's model, such as ``driver``; empty: there is no choice."""
    for _, metadata in _options(annotation):
        for part in metadata:
            if isinstance(part, FieldInfo) and isinstance(part.discriminator, str):
                return part.discriminator
    return ""


def tags_of(model: type[Table], tag: str) -> tuple[str, ...]:
    """Return the values of a tag that select a model."""
    field = model.model_fields.get(tag)
    return () if field is None else get_args(field.annotation)


def _step(annotation: Any, key: str | int, node: Any) -> tuple[Any, list[Any]] | None:
    for model in tables_at(annotation, node):
        if key in model.model_fields:
            field: FieldInfo = model.model_fields[str(key)]
            return field.annotation, field.metadata
    for option, _ in _options(annotation):
        if get_origin(option) is tuple and isinstance(key, int):
            return get_args(option)[0], []
        if get_origin(option) is dict and isinstance(key, str):
            return get_args(option)[1], []
    return None


@cache
def _options(annotation: Any) -> tuple[tuple[Any, tuple[Any, ...]], ...]:
    """Return the types inside ``Annotated`` and unions, with their metadata, without None."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return tuple((option, (*more, *metadata)) for option, metadata in _options(inner))
    if get_origin(annotation) in (Union, types.UnionType):
        return tuple(found for option in get_args(annotation) for found in _options(option))
    return () if annotation is types.NoneType else ((annotation, ()),)


def _plain(annotation: Any, metadata: list[Any]) -> tuple[Any, list[Any]]:
    """Return the only type inside ``Annotated`` and ``| None``; if there are several, the union."""
    options = _options(annotation)
    if len(options) == 1 or (options and all(_is_table(option) for option, _ in options)):
        return options[0][0], [*metadata, *options[0][1]]
    return annotation, metadata


def _is_table(option: Any) -> bool:
    return isinstance(option, type) and issubclass(option, Table)


def _parts(limit: Any) -> list[Any]:
    """Return the limits in a ``Field(…)`` inside ``Annotated``, or the limit itself."""
    return limit.metadata if isinstance(limit, FieldInfo) else [limit]


def _size(limits: dict[str, Any], kind: str) -> int | None:
    names = {"MinLen": "min_length", "MaxLen": "max_length"}
    return getattr(limits[kind], names[kind]) if kind in limits else None


def _limit(limits: dict[str, Any], kind: str, form: str) -> str:
    return form.format(getattr(limits[kind], kind.lower())) if kind in limits else ""
