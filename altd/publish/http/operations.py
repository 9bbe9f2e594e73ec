"""A path of the API: its methods, the input and output of each, and its errors."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import Response

from altd.publish.http.answers import Answers

JSON = "application/json"

Handler = Callable[[Answers, Request], Awaitable[Response]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter with its JSON Schema; optional in the query, required in the path."""

    name: str
    meaning: str
    schema: Mapping[str, object]
    is_in_path: bool = False
    """Whether the parameter is part of the path and therefore required."""


@dataclass(frozen=True, slots=True)
class Operation:
    """One method of a path. ``model`` is the object of a successful response; None: no object.

    ``errors`` explains each error of its own, by status, in one sentence; errors that any path may return are
    in ``COMMON_ERRORS``.
    """

    handler: Handler
    summary: str
    model: type[BaseModel] | str | None = None
    """``measurement``: the model of the unit's quantities, which are known only at its start."""
    media_type: str = JSON
    status: int = 200
    takes: type[BaseModel] | None = None
    errors: Mapping[int, str] = field(default_factory=dict)
    query: tuple[Parameter, ...] = ()
    acts: bool = False
    """Whether the request needs the header that pages of other sites cannot send."""
    needs_actor: bool = False
    """Whether the request needs a user with permission to act."""


@dataclass(frozen=True, slots=True)
class ServedPath:
    """A served path with its operations by method; ``GET`` includes ``HEAD``."""

    path: str
    gives: str
    operations: Mapping[str, Operation]

    @property
    def is_old(self) -> bool:
        """Whether it is a path of the first release; these paths never change."""
        return not self.path.startswith("/api/v1") and self.path.startswith("/api/")


COMMON_ERRORS = {
    400: "not an HTTP request",
    404: "there is no such path",
    411: "the body has no `Content-Length`",
    414: "the path with its query is too long",
    431: "the header is too large, or has too many lines",
    405: "the path does not support the method; `Allow` lists the supported ones",
    421: "the name in `Host` is not a name of the unit",
    429: "too many requests; `Retry-After` is the time to wait in seconds",
    500: "a defect of the unit; its log has the details",
    505: "another version than HTTP/1.0 or HTTP/1.1",
}
"""Meanings of the errors that any path may return, by status."""
