"""Errors of a config: pydantic's errors in plain words, each with its key."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from altd.config.fields import expected, field_at, tables_at, tag_at, tags_of
from altd.config.places import Keys, Place, Places
from altd.config.whole import Config
from altd.errors import did_you_mean
from altd.files.table import FAULTS, Table, shown


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a config: its key, what is wrong and what is possible.

    ``about`` are other keys that it depends on: if one of these is faulty itself, the fault may not exist.
    """

    keys: Keys
    text: str
    at: Literal["value", "key", "table"] = "value"
    """Part of the key to locate: its value, the key, or, if it is missing, its table."""
    about: tuple[Keys, ...] = ()
    replaces: tuple[Keys, ...] = ()
    """Keys that an unknown name was probably meant for: a fault of one of them follows from this fault."""

    def place(self, places: Places) -> Place | None:
        """Return the place of the fault in the file."""
        match self.at:
            case "value":
                others = (places.key(keys) or places.nearest(keys) for keys in self.about)
                return places.value(self.keys) or places.nearest(self.keys) or next(others, None)
            case "key":
                return places.key(self.keys)
            case "table":
                return places.nearest(self.keys)

    def rests_on(self, faulty: Iterable[Keys]) -> bool:
        """Whether its key or one in ``about``, or a table above them, is among these keys."""
        mine = (self.keys, *self.about)
        return any(keys[: len(other)] == other for keys in mine for other in faulty)


WHY = {
    "string_type": "is not text: write it in quotes",
    "string_unicode": "is not valid Unicode",
    "string_too_short": "is too short",
    "string_too_long": "is too long",
    "string_pattern_mismatch": "has characters that are not allowed",
    "int_type": "is not a whole number",
    "int_parsing": "is not a whole number",
    "int_from_float": "is not a whole number",
    "int_parsing_size": "has too many digits",
    "float_type": "is not a number",
    "float_parsing": "is not a number",
    "finite_number": "is not a finite number",
    "greater_than": "is too small",
    "greater_than_equal": "is too small",
    "less_than": "is too large",
    "less_than_equal": "is too large",
    "literal_error": "is not possible",
    "bool_type": "is neither true nor false",
    "bool_parsing": "is neither true nor false",
    "tuple_type": "is not a list in [ ]",
    "too_short": "has too few elements",
    "too_long": "has too many elements",
    "dict_type": "is not a table",
    "model_type": "is not a table",
    "model_attributes_type": "is not a table",
    "path_type": "is not a path: write it in quotes",
    "path_from_text": "is not a path",
    "union_tag_invalid": "is not possible",
}
"""Sentence about a value, by the type of pydantic's error."""

UNUSABLE = "cannot be used"
_SECRETS = ("login", "password", "token", "user", "username")


def converted_values(document: dict[str, Any]) -> Iterator[Fault]:
    """Yield values that pydantic would convert to another type: ``true`` to 1, ``"4"`` to 4, 1 to true."""
    nodes: list[tuple[Keys, Any]] = [((), document)]
    while nodes:
        keys, node = nodes.pop()
        if isinstance(node, dict | list):
            pairs = node.items() if isinstance(node, dict) else enumerate(node)
            nodes += [((*keys, key), below) for key, below in pairs]
        elif (found := field_at(keys, document, Config)) is not None:
            takes = expected(*found, shown)
            is_number = ("number" in takes and "true" not in takes) or takes.split(" or ")[-1].isdigit()
            is_boolean = takes == "true or false"
            why = ""
            if isinstance(node, str) and (is_number or is_boolean) and _is_unquoted(node, is_boolean):
                why = f"is text; possible: {takes}; write it without quotes"
            elif is_number and isinstance(node, bool):
                why = f"is not a number; possible: {takes}"
            elif is_boolean and not isinstance(node, bool):
                why = f"{WHY['bool_type']}; possible: {takes}"
            if why:
                yield Fault(keys, f"{shown(node)} {why}")


def _is_unquoted(text: str, is_boolean: bool) -> bool:
    """Whether the text without its quotes would be a number or boolean."""
    if is_boolean:
        return text in ("true", "false")
    try:
        float(text)
    except ValueError:
        return False
    return True


def faults_of(error: ValidationError, document: dict[str, Any], kind: type[Table] = Config) -> list[Fault]:
    """Return pydantic's errors about a document of this kind, one fault per key."""
    found: dict[tuple[Keys, str], Fault] = {}
    for detail in error.errors(include_url=False):
        counted = detail.get("ctx", {}).get("min_length", 0)
        if detail["type"] == "too_short" and len(detail["input"]) >= counted:
            continue  # pydantic counts only the valid elements
        for fault in _worded(detail, document, kind):
            text = "" if detail["type"] == FAULTS else "one"  # each member of a union reports an error
            found.setdefault((fault.keys, text or fault.text), fault)
    return list(found.values())


def _worded(detail: ErrorDetails, document: dict[str, Any], model: type[Table]) -> Iterator[Fault]:
    keys, what = _keys(detail, document, model)
    kind, value = detail["type"], detail["input"]
    context = detail.get("ctx", {})
    if kind == FAULTS:
        for more, text in context["faults"]:
            yield Fault((*keys, *more), text)
    elif kind == "extra_forbidden":
        yield _unknown_key(keys, document, model)
    elif kind == "missing":
        possible = _possible_values(keys, document, model).removesuffix("; possible: table")
        kind_of_it = "table" if len(keys) == 1 and (model is Config or not possible) else "key"
        yield Fault(keys, f"this {kind_of_it} is missing{possible}", "table")
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        yield _tag_fault(keys, value, document, model)
    elif kind == "tuple_type" and isinstance(value, dict) and len(keys) == 1:
        yield Fault(keys, f"there may be several of this table; write `[[{keys[0]}]]`", "table")
    elif what == "key":
        takes = expected(*_key_type(keys, model), shown)
        yield Fault(keys, f"a name {WHY.get(kind, UNUSABLE)}; possible: {takes}", "key")
    else:
        why = UNUSABLE if what == "member" else WHY.get(kind, UNUSABLE)
        suggestion = _suggestion(kind, value, context)
        possible = _possible_values(keys, document, model).removesuffix("; possible: text")
        yield Fault(keys, f"{shown(value)} {why}{possible}{suggestion}")


def _keys(
    detail: ErrorDetails, document: Any, model: type[Table]
) -> tuple[Keys, Literal["value", "key", "member"]]:
    """Return the keys in the file, and the faulty part: value, key itself, or a union's member.

    pydantic inserts more: between a table and its key the value of its tag, after a key the member of a union
    that failed, or ``[key]``.
    """
    keys: list[str | int] = []
    table, last = document, len(detail["loc"]) - 1
    tag = ""
    for number, part in enumerate(detail["loc"]):
        if part == "[key]" and number == last:
            return tuple(keys), "key"
        if tag and isinstance(table, dict) and part == table.get(tag):
            tag = ""
            continue
        there = isinstance(table, dict) and part in table
        there |= isinstance(table, list) and isinstance(part, int) and part < len(table)
        if not there and not (detail["type"] == "missing" and number == last):
            return tuple(keys), "member"
        keys.append(part)
        table = table[part] if there else None
        tag = tag_at(_type_at(tuple(keys), document, model))
    return tuple(keys), "value"


def _tag_fault(keys: Keys, table: Any, document: dict[str, Any], kind: type[Table]) -> Fault:
    """Return the fault of a table whose tag, such as ``driver``, is missing or has no possible value."""
    annotation = _type_at(keys, document, kind)
    tag = tag_at(annotation)
    values = [value for model in tables_at(annotation, None) for value in tags_of(model, tag)]
    choice = " or ".join(map(shown, values))
    if isinstance(table, dict) and tag not in table:
        return Fault((*keys, tag), f"this key is missing; possible: {choice}", "table")
    value = table.get(tag) if isinstance(table, dict) else table
    suggestion = did_you_mean(value, values)
    return Fault((*keys, tag), f"{shown(value)} {WHY['union_tag_invalid']}; possible: {choice}{suggestion}")


def _unknown_key(keys: Keys, document: dict[str, Any], kind: type[Table]) -> Fault:
    """Return the fault of an unknown key: the possible keys, and the probable intended one."""
    above, name = keys[:-1], keys[-1]
    table: Any = document
    for key in above:
        table = table[key]
    annotation = _type_at(above, document, kind)
    models = tables_at(annotation, table)
    possible = sorted({key for model in models for key in model.model_fields})
    is_table = not above and isinstance(table[name], dict | list)
    what = "table" if is_table else "key"
    free = [key for key in possible if key not in table or (is_table and isinstance(table[key], dict | list))]
    suggestion = did_you_mean(name, free or possible)
    replaces: list[Keys] = [(*above, suggestion.split("`")[1])] if suggestion else []
    if name in _SECRETS and "credentials" in possible:
        suggestion = "; names and passwords are in a file of their own: `credentials` is its path"
    elif not suggestion and (homes := _tables_with(name, kind)):
        suggestion = f"; it is a {what} of {' and of '.join(homes.values())}"
        replaces = [(home,) for home in homes if home != keys[0]]
    text = f"there is no such {what}; possible: {', '.join(possible)}{suggestion}"
    return Fault(keys, text, "key", replaces=tuple(replaces))


def _tables_with(name: str | int, kind: type[Table]) -> dict[str, str]:
    """Return the tables that have such a key, each as written in the file and with its tag."""
    homes = {}
    for table, field in kind.model_fields.items():
        inner, home = field.annotation, f"[{table}]"
        if get_origin(inner) is dict:
            inner, home = get_args(inner)[1], f"[{table}.NAME]"
        elif get_origin(inner) is tuple:
            inner, home = get_args(inner)[0], f"[[{table}]]"
        models, tag = tables_at(inner, None), tag_at(inner)
        having = [model for model in models if name in model.model_fields]
        if having:
            values = [shown(value) for model in having for value in tags_of(model, tag)]
            homes[table] = home if having == models else f"{home} with {tag} = {' or '.join(values)}"
    return homes


def _suggestion(kind: str, value: object, context: dict[str, Any]) -> str:
    if kind == "tuple_type" and isinstance(value, str):
        return f"; did you mean `[{shown(value)}]`?"
    if kind != "literal_error" or not isinstance(value, str):
        return ""
    return did_you_mean(
        value, str(context.get("expected", "")).replace(" or ", ", ").replace("'", "").split(", ")
    )


def _possible_values(keys: Keys, document: dict[str, Any], kind: type[Table]) -> str:
    """Return the values that a key accepts, as the end of a sentence."""
    found = field_at(keys, document, kind)
    return "" if found is None else f"; possible: {expected(*found, shown)}"


def _type_at(keys: Keys, document: dict[str, Any], kind: type[Table]) -> Any:
    found = field_at(keys, document, kind)
    return None if found is None else found[0]


def _key_type(keys: Keys, kind: type[Table]) -> tuple[Any, list[Any]]:
    """Return the key type of a table with free keys."""
    found = field_at(keys[:-1], {}, kind)
    return (str, []) if found is None else (get_args(found[0])[0], [])
