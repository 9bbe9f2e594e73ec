"""Errors as this interface says them: always one JSON object with ``error``, whoever refuses."""

from __future__ import annotations

import json
from collections.abc import Mapping

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response


def refusal(status: int, sentence: str, headers: Mapping[str, str] | None = None) -> Response:
    """An error as the answer to a request."""
    return JSONResponse({"error": sentence}, status_code=status, headers=headers)


def error_body(sentence: str) -> bytes:
    """The same object for who has no application, because what came is no HTTP."""
    return json.dumps({"error": sentence}, separators=(",", ":")).encode()


async def of_defect(_: Request, __: Exception) -> Response:
    """500: whatever a handler fails on, among it a number that JSON does not have."""
    return refusal(500, "a defect of the unit; its log says more")


async def of_routing(_: Request, error: Exception) -> Response:
    """404 and 405, which starlette finds out."""
    assert isinstance(error, HTTPException)  # noqa: S101  it is registered for no other
    return refusal(error.status_code, error.detail, error.headers)
