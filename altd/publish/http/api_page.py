"""The API for people: one page of plain HTML, made of the OpenAPI document, without any script."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from typing import Any

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
    """The page. All of the document is shown as text, never as HTML."""
    return "\n".join(_lines(document)) + "\n"


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    about = document["info"]
    title, version = escape(about["title"]), escape(about["version"])
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f'<title>{title}: API</title>\n<link rel="icon" href="data:,">'
    yield f"<style>\n{_STYLE}\n</style>\n</head>\n<body>\n<h1>{title}: API</h1>"
    yield f"<p>{escape(about['description'])} altd {version}."
    yield 'For programs: <a href="/api/v1/openapi.json">openapi.json</a> (OpenAPI 3.1).'
    yield '<a href="/">The unit\'s page</a>.</p>'
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            if method != "head":  # GET includes it
                yield from _operation(path, method, operation)
    yield "<h1>Objects</h1>"
    for name, schema in document["components"]["schemas"].items():
        yield from _schema(name, schema)
    yield "</body>\n</html>"


def _operation(path: str, method: str, operation: Mapping[str, Any]) -> Iterator[str]:
    link = f'<a href="{escape(path)}">{escape(path)}</a>' if method == "get" else escape(path)
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
    """A schema in a few words, with links to the objects."""
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
    """Markdown's code spans, the only markup in descriptions."""
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
