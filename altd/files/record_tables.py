"""Tables of a document that hold a record: one description of keys, types and limits reads and writes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from pydantic import BaseModel, GetCoreSchemaHandler, GetPydanticSchema, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

AnyTable = TypeVar("AnyTable", bound=BaseModel)
Read = Callable[[Any, ValidationInfo], Any]


@dataclass(frozen=True, slots=True)
class At:
    """The attribute of the record that a field holds, where it is not the one of the field's name.

    ``path`` may lead through attributes and indices, as ``camera.serial`` or ``spectra.0``; empty: the record
    itself, as for a table of some of its attributes. ``shown`` converts a value that is not read back.
    ``or_absent``: a file has no such key where it is None.
    """

    path: str
    shown: Callable[[Any], Any] | None = None
    or_absent: bool = False


def _place_of(name: str, field: FieldInfo) -> At:
    return next((part for part in field.metadata if isinstance(part, At)), At(name))


def _constant(field: FieldInfo) -> Any:
    """Return the only value of a field that names a format, and is no attribute; else None."""
    values = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    return values[0] if len(values) == 1 else None


def _table_in(field: FieldInfo) -> type[BaseModel] | None:
    kinds = (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _attribute(record: Any, path: str) -> Any:
    for key in filter(None, path.split(".")):
        if record is None:
            return None
        record = record[int(key)] if key.isdigit() else getattr(record, key)
    return record


def table_from(table: type[AnyTable], record: object, **given: Any) -> AnyTable:
    """Return the table of a record, with unchecked values; ``given`` are those that it does not have."""
    values = dict(given)
    for name, field in table.model_fields.items():
        if name in given:
            continue
        at, inner = _place_of(name, field), _table_in(field)
        value = _constant(field) or _attribute(record, at.path)
        if value is not None and inner is not None:
            value = table_from(inner, value)
        elif value is not None and at.shown is not None:
            value = at.shown(value)
        if not (value is None and at.or_absent):
            values[name] = value
    return table.model_construct(**values)


def attributes_of(table: BaseModel) -> dict[str, Any]:
    """Return the values of a table by the paths of their attributes."""
    values: dict[str, Any] = {}
    for name, field in type(table).model_fields.items():
        path, value = _place_of(name, field).path, getattr(table, name)
        if isinstance(value, BaseModel):
            values |= {f"{path}.{key}".lstrip("."): inner for key, inner in attributes_of(value).items()}
        elif _constant(field) is None:
            values[path] = value
    return values


def record_from(record: type, values: Mapping[str, Any]) -> Any:
    """Return the record with these values; an optional record in it is None if its first value is."""
    own: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, rest = path.partition(".")
        if rest:
            parts.setdefault(name, {})[rest] = value
        else:
            own[name] = value
    types = get_type_hints(record) if parts else {}
    for name, inner in parts.items():
        kind, *others = get_args(types[name]) or (types[name],)
        is_none = others and next(iter(inner.values())) is None
        own[name] = None if is_none else record_from(kind, inner)
    return record(**own)


def held_in(table: type[BaseModel], record: type, read: Read | None = None) -> GetPydanticSchema:
    """Read a record from a table and write it as one; ``read``: how to make it, if not of its attributes."""
    made = read or (lambda values, _: record_from(record, attributes_of(values)))

    def schema(_: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(
            made,
            handler.generate_schema(table),
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda value, write: write(table_from(table, value))
            ),
        )

    return GetPydanticSchema(schema)
