"""The OpenAPI 3.1 document of the API, made of the table of paths and of the models."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from altd.publish.http.guard import REQUEST_HEADER
from altd.publish.http.models import Error
from altd.publish.http.operations import COMMON_ERRORS, JSON, Operation, ServedPath
from altd.records import Quantities
from altd.status.models import measurement_model

_SCHEMA = "#/components/schemas/{model}"
_ANYBODY: dict[str, list[str]] = {}

_SECURITY_SCHEMES = {
    "token": {"type": "http", "scheme": "bearer", "description": "A token that `altd token` made."},
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": "altd_8080",
        "description": "The cookie that `/api/v1/login` gives; its name ends in the port, and begins with "
        "`__Host-` with TLS.",
    },
}

_HEADER_PARAMETER = {
    "name": REQUEST_HEADER,
    "in": "header",
    "required": True,
    "description": "Anything. No page of another site can send it.",
    "schema": {"type": "string"},
}
_NO_WORD = str.maketrans({"/": "_", "-": "_", ".": "_", "{": None, "}": None})
"""Of a path, in the name of an operation."""
_RETRY_AFTER = {"description": "Seconds to wait.", "schema": {"type": "integer", "minimum": 1}}


def document_of(paths: Iterable[ServedPath], quantities: Quantities, version: str) -> dict[str, Any]:
    """The document of a unit with these quantities; the old paths, which stay beside, are not in it."""
    served = [path for path in paths if not path.is_old]
    operations = [operation for path in served for operation in path.operations.values()]
    measurement = measurement_model(quantities)
    shown: dict[type[BaseModel], JsonSchemaMode] = {Error: "serialization"}
    for operation in operations:
        if (model := _model(operation, measurement)) is not None:
            shown[model] = "serialization"
        if operation.takes is not None:
            shown[operation.takes] = "validation"
    names, definitions = models_json_schema(list(shown.items()), ref_template=_SCHEMA)
    references = {model: reference for (model, _), reference in names.items() if issubclass(model, BaseModel)}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Active Laser Target",
            "version": version or "unknown",
            "description": "Measurements of a unit with their uncertainty, and its state.",
        },
        "servers": [{"url": "/"}],
        "paths": {path.path: dict(_operations(path, measurement, references)) for path in served},
        "components": {
            "schemas": definitions.get("$defs", {}),
            "securitySchemes": _SECURITY_SCHEMES,
        },
    }


def _model(operation: Operation, measurement: type[BaseModel]) -> type[BaseModel] | None:
    return measurement if isinstance(operation.model, str) else operation.model


def _operations(
    path: ServedPath, measurement: type[BaseModel], references: Mapping[type[BaseModel], Any]
) -> Iterable[tuple[str, dict[str, Any]]]:
    for method, operation in path.operations.items():
        model = _model(operation, measurement)
        schema = {"type": "string"} if model is None else references[model]
        responses: dict[str, Any] = {
            str(operation.status): {
                "description": operation.summary,
                "content": {operation.media_type: {"schema": schema}},
            }
        }
        errors = {**COMMON_ERRORS, **operation.errors}
        responses |= {str(status): _error(status, errors[status], references) for status in sorted(errors)}
        described: dict[str, Any] = {
            "operationId": _operation_id(method, path.path),
            "summary": operation.summary,
            "responses": responses,
        }
        if operation.takes is not None:
            described["requestBody"] = {
                "required": True,
                "content": {JSON: {"schema": references[operation.takes]}},
            }
        parameters: list[dict[str, Any]] = [
            {
                "name": each.name,
                "in": "path" if each.is_in_path else "query",
                "description": each.meaning,
                "schema": dict(each.schema),
                **({"required": True} if each.is_in_path else {}),
            }
            for each in operation.query
        ]
        if operation.acts:
            parameters.append(_HEADER_PARAMETER)
        if parameters:
            described["parameters"] = parameters
        if operation.needs_actor:
            described["security"] = [{name: []} for name in _SECURITY_SCHEMES] + [_ANYBODY]
        yield method.lower(), described
        if method == "GET":
            yield "head", _head(described, _operation_id("HEAD", path.path))


def _error(status: int, meaning: str, references: Mapping[type[BaseModel], Any]) -> dict[str, Any]:
    described: dict[str, Any] = {"description": meaning, "content": {JSON: {"schema": references[Error]}}}
    if status == 429:
        described["headers"] = {"Retry-After": _RETRY_AFTER}
    return described


def _head(described: Mapping[str, Any], operation_id: str) -> dict[str, Any]:
    """The same without bodies."""
    responses = {
        status: {key: part for key, part in response.items() if key != "content"}
        for status, response in described["responses"].items()
    }
    return {
        **described,
        "operationId": operation_id,
        "summary": f"{described['summary']}: the headers alone",
        "responses": responses,
    }


def _operation_id(method: str, path: str) -> str:
    words = path.removeprefix("/api/v1").strip("/").translate(_NO_WORD)
    return f"{method.lower()}_{words or ('page' if path == '/' else 'api')}"
