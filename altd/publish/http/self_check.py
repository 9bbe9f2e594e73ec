"""The self-check over HTTP: any client reads it, one that may act requests it (``guard``)."""

from __future__ import annotations

import asyncio

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from altd.publish.http.errors import refusal
from altd.publish.http.guard import Guard
from altd.status.services import SelfCheckService

WAIT_S = 25.0
"""A check that was asked for has ended by then, unless the cameras do not deliver."""

MAX_WAITING = 8
"""More do not wait for a check at once, so that connections are left for those who read."""


async def answer(request: Request, service: SelfCheckService, guard: Guard) -> Response:
    """The report of the last check; after a POST, that of a check made on request."""
    if request.method != "POST":
        if service.latest is None:
            why = service.unavailable or "there was no self-check since the unit started"
            return JSONResponse({"verdict": None, "reasons": [why], "unavailable": service.unavailable})
        return JSONResponse(service.latest.document)
    by = guard.requester(request)
    if service.waiting >= MAX_WAITING:
        return refusal(503, f"{service.waiting} wait for a self-check already; /api/self-check has it soon")
    number = service.ask(by)
    try:
        async with asyncio.timeout(WAIT_S):
            report = await service.report(number)
    except TimeoutError:
        return refusal(504, f"the self-check has not ended within {WAIT_S:g} s; /api/status says why")
    return JSONResponse(report.document)
