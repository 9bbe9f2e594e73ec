"""The unit's document, and the check of an answer against it."""

from __future__ import annotations

from typing import Any

from jsonschema import Draft202012Validator

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.openapi import document_of
from altd.publish.http.paths import PATHS

from .conftest import Answer

DOCUMENT = document_of(PATHS, QUANTITIES, "0.1.0")
NEED_MORE = (
    *("/api/v1/trend", "/api/v1/events"),
    *("/api/v1/calibration", "/api/v1/calibration/file", "/api/v1/calibration/report"),
)
"""Answers of a history or a calibration, which the unit of most tests has not."""


def fits(document: dict[str, Any], path: str, answer: Answer, method: str = "get") -> Any:
    """The answer's object, after jsonschema has held it against the document."""
    response = document["paths"][path][method]["responses"][str(answer.status)]
    schema = response["content"]["application/json"]["schema"]
    whole = {**schema, "components": document["components"]}
    Draft202012Validator(whole).validate(answer.json)
    return answer.json
