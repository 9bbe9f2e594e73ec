"""Every error that our models can raise has a text of our own; an unexpected one is usable too."""

import tomllib
from typing import Any

import pytest
from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from altd.config import Config
from altd.config.wording import WHY, faults_of

from .whole_config import BASE

RAISED_BY = {
    "str": {"string_type", "string_unicode"},
    "int": {"int_type", "int_parsing", "int_parsing_size", "int_from_float"},
    "float": {"float_type", "float_parsing", "finite_number"},
    "bool": {"bool_type", "bool_parsing"},
    "literal": {"literal_error"},
    "tuple": {"tuple_type"},
    "dict": {"dict_type"},
    "model": {"model_type", "model_attributes_type"},
    "model-fields": {"model_type", "missing", "extra_forbidden"},
    "tagged-union": {"union_tag_invalid", "union_tag_not_found"},
    "is-instance": {"path_type"},
    "function-after": {"faults"},
}
"""Kinds of pydantic's schema and the errors that each can raise (docs.pydantic.dev, validation errors)."""
LIMITS = {
    "ge": {"greater_than_equal"},
    "gt": {"greater_than"},
    "le": {"less_than_equal"},
    "lt": {"less_than"},
    "min_length": {"string_too_short", "too_short"},
    "max_length": {"string_too_long", "too_long"},
    "pattern": {"string_pattern_mismatch"},
    "multiple_of": {"multiple_of"},
}
RAISES_NOTHING = {
    *("model-field", "default", "nullable", "union", "lax-or-strict", "json-or-python", "definitions"),
    *("definition-ref", "function-plain", "no-info", "computed-field"),
}
"""They only hold other kinds together; a union passes on what its members raise."""
OF_KEYS = {"missing", "extra_forbidden", "union_tag_not_found", "faults"}
"""They are about a key and not about its value."""


def kinds(schema: Any) -> tuple[set[str], set[str]]:
    """The kinds of schema in a schema, and the limits in it."""
    found, limits, nodes = set(), set(), [schema]
    while nodes:
        node = nodes.pop()
        if isinstance(node, dict):
            if isinstance(node.get("type"), str):
                found.add(node["type"])
                limits |= {key for key in LIMITS if node.get(key) is not None}
            nodes += [value for key, value in node.items() if key not in ("metadata", "serialization")]
        elif isinstance(node, list | tuple):
            nodes += node
    return found, limits


def test_there_are_words_for_every_error_that_our_models_can_raise() -> None:
    found, limits = kinds(Config.__pydantic_core_schema__)
    assert {"str", "int", "float", "tuple", "dict", "model-fields", "tagged-union"} <= found
    assert found - RAISES_NOTHING <= RAISED_BY.keys(), "a new kind of schema: which errors can it raise?"
    raised = set().union(
        *(RAISED_BY[kind] for kind in found if kind in RAISED_BY), *(LIMITS[at] for at in limits)
    )
    assert raised - OF_KEYS <= WHY.keys()


@pytest.mark.parametrize("kind", sorted(WHY))
def test_no_words_are_pydantic_s(kind: str) -> None:
    assert not WHY[kind].startswith(("Input should", "String should", "Field", "Value"))


def test_an_error_that_nobody_thought_of_names_the_value_and_what_is_possible() -> None:
    detail = InitErrorDetails(
        type=PydanticCustomError("of_next_year", "Input should be purple"),
        loc=("measuring", "window"),
        input=20,
        ctx={},
    )
    error = ValidationError.from_exception_data("Config", [detail])
    (fault,) = faults_of(error, tomllib.loads(BASE))
    assert fault.keys == ("measuring", "window")
    assert fault.text == "20 cannot be used; possible: whole number from 1 to 1000"


def test_a_value_that_fits_no_kind_of_a_key_is_one_fault() -> None:
    document = tomllib.loads(BASE.replace("{ Gamma = 1.0 }", "{ Gamma = [1.0], Other = { a = 1 } }"))
    with pytest.raises(ValidationError) as caught:
        Config.model_validate(document)
    faults = faults_of(caught.value, document)
    assert [fault.keys[-1] for fault in faults] == ["Gamma", "Other"]
