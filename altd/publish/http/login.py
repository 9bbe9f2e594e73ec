"""Logging in and out, and the user that is logged in."""

from __future__ import annotations

import asyncio

from pydantic import ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard, session_cookie
from altd.publish.http.models import Login

MAX_BODY_BYTES = 4096
BODY_TIMEOUT_S = 10.0
"""The time limit of a request's body."""


async def log_in(request: Request, guard: Guard) -> Response:
    """Begin a session: its secret goes into a cookie that no script can read."""
    try:
        wanted = await _login_of(request)
    except ClientDisconnect:
        return refusal(400, "it ended before its body did")
    secret = await guard.log_in(request, wanted.name, wanted.password)
    answer = JSONResponse({"name": wanted.name, "may_act": True, "login": True})
    answer.headers["Set-Cookie"] = session_cookie(request, secret)
    return answer


async def log_out(request: Request, guard: Guard) -> Response:
    """End the session, if there is one."""
    guard.log_out(request)
    answer = JSONResponse({"name": None, "may_act": False, "login": guard.has_credentials})
    answer.headers["Set-Cookie"] = session_cookie(request, "")
    return answer


async def session(request: Request, guard: Guard) -> Response:
    """The user that is logged in, and whether the user may act."""
    shown = {
        "name": guard.viewer(request),
        "may_act": guard.may_act(request),
        "login": guard.has_credentials,
    }
    return JSONResponse(shown)


async def _login_of(request: Request) -> Login:
    """The name and password of a request; raises Refused."""
    kind = request.headers.get("Content-Type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise Refused(refusal(415, "the body must be application/json"))
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            return Login.model_validate_json(await _body_of(request), strict=True)
    except ValidationError as error:  # the input is not shown again
        raise Refused(refusal(400, "the body must be an object with name and password alone")) from error
    except TimeoutError as error:
        raise Refused(refusal(408, "its body did not come")) from error


async def _body_of(request: Request) -> bytes:
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > MAX_BODY_BYTES:
            raise Refused(refusal(413, f"its body is longer than {MAX_BODY_BYTES} bytes"))
    return body
