"""Description of the API: an OpenAPI 3.1 document for programs, made from the table of paths and the models.

For people a page of plain HTML without scripts, made from the document.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from altd.publish.http.guard import REQUEST_HEADER
from altd.publish.http.models import Error
from altd.publish.http.operations import COMMON_ERRORS, JSON, Operation, ServedPath
from altd.records import Quantities
from altd.status.measurement_json import measurement_model

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
"""Replacements of characters of a path in the name of an operation."""
_RETRY_AFTER = {"description": "Seconds to wait.", "schema": {"type": "integer", "minimum": 1}}


def document_of(paths: Iterable[ServedPath], quantities: Quantities, version: str) -> dict[str, Any]:
    """Return the document of a unit with these quantities; it omits the old paths, which are still served."""
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
        "components": {"schemas": definitions.get("$defs", {}), "securitySchemes": _SECURITY_SCHEMES},
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
    """Return the HEAD operation of a GET operation: the same without bodies."""
    responses = {
        status: {key: part for key, part in response.items() if key != "content"}
        for status, response in described["responses"].items()
    }
    return {
        **described,
        "operationId": operation_id,
        "summary": f"{described['summary']}: only the headers",
        "responses": responses,
    }


def _operation_id(method: str, path: str) -> str:
    words = path.removeprefix("/api/v1").strip("/").translate(_NO_WORD)
    return f"{method.lower()}_{words or ('page' if path == '/' else 'api')}"


_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem; }
h2 { margin-top: 2rem; font-size: 1.05rem; } h2 code { font-size: 1.05rem; }
table { border-collapse: collapse; width: 100%; margin: .5rem 0; }
td { vertical-align: top; padding: .3rem .6rem .3rem 0; border-bottom: 1px solid #8885; }
td:first-child { white-space: nowrap; }
.method { font-weight: 600; margin-right: .5rem; }
""".strip()


def api_page_of(document: Mapping[str, Any]) -> str:
    """Return the page. All content of the document is shown as text, never as HTML."""
    return "\n".join(_lines(document)) + "\n"


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    about = document["info"]
    title, version = escape(about["title"]), escape(about["version"])
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f'<title>{title}: API</title>\n<link rel="icon" href="data:,">'
    yield f"<style>\n{_STYLE}\n</style>\n</head>\n<body>\n<h1>{title}: API</h1>"
    yield f"<p>{escape(about['description'])} altd {version}."
    yield 'For programs: <a href="openapi.json">openapi.json</a> (OpenAPI 3.1).'
    yield '<a href="../../">The unit\'s page</a>.</p>'
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            if method != "head":  # GET includes it
                yield from _operation(path, method, operation)
    yield "<h1>Objects</h1>"
    for name, schema in document["components"]["schemas"].items():
        yield from _schema(name, schema)
    yield "</body>\n</html>"


def _operation(path: str, method: str, operation: Mapping[str, Any]) -> Iterator[str]:
    link = f'<a href="../..{escape(path)}">{escape(path)}</a>' if method == "get" else escape(path)
    yield f'<h2 id="{escape(operation["operationId"])}"><span class="method">{method.upper()}</span>'
    yield f"<code>{link}</code></h2>\n<p>{escape(operation['summary'])}.</p>"
    rows = [
        (
            f"<code>{escape(each['name'])}</code>",
            f"{escape(each['in'])}: {_prose(each.get('description', ''))}",
        )
        for each in operation.get("parameters", ())
    ]
    if "requestBody" in operation:
        rows.append(("body", _content(operation["requestBody"]["content"])))
    for status, response in operation["responses"].items():
        content = _content(response.get("content", {}))
        rows.append(
            (
                escape(status),
                f"{_prose(response['description'])}: {content}"
                if content
                else _prose(response["description"]),
            )
        )
    yield _table(rows)


def _schema(name: str, schema: Mapping[str, Any]) -> Iterator[str]:
    yield f'<h2 id="{escape(name)}"><code>{escape(name)}</code></h2>'
    yield f"<p>{_prose(schema.get('description', ''))}</p>"
    if "enum" in schema:
        yield (
            "<p>"
            + ", ".join(f"<code>{escape(json.dumps(value))}</code>" for value in schema["enum"])
            + "</p>"
        )
    rows = [
        (f"<code>{escape(key)}</code>", _type(part), _prose(part.get("description", "")))
        for key, part in schema.get("properties", {}).items()
    ]
    if isinstance(others := schema.get("additionalProperties"), dict):
        rows.append(("any other key", _type(others), ""))
    if rows:
        yield _table(rows)


def _table(rows: Iterable[tuple[str, ...]]) -> str:
    lines = ("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def _content(content: Mapping[str, Any]) -> str:
    return ", ".join(
        f"<code>{escape(media)}</code> {_type(part['schema'])}" for media, part in content.items()
    )


def _type(schema: Mapping[str, Any]) -> str:
    """Return a short description of a schema, with links to the objects."""
    if "$ref" in schema:
        name = escape(schema["$ref"].rpartition("/")[2])
        return f'<a href="#{name}">{name}</a>'
    if "anyOf" in schema:
        return " or ".join(map(_type, schema["anyOf"]))
    if "const" in schema:
        return f"<code>{escape(json.dumps(schema['const']))}</code>"
    if "enum" in schema:
        return " or ".join(f"<code>{escape(json.dumps(value))}</code>" for value in schema["enum"])
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    if isinstance(values := schema.get("additionalProperties"), dict):
        return f"object of {_type(values)}"
    return escape(schema.get("type", "anything"))


def _prose(text: str) -> str:
    """Return a text as HTML with its code spans, the only Markdown in descriptions."""
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
