"""Responses of the paths, each from one reading of the board, and the files of the page."""

from __future__ import annotations

import asyncio
import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from altd.publish.http.calibration import LoadedCalibration
from altd.publish.http.clients import MAX_WAITING, SELF_CHECK_WAIT_S
from altd.publish.http.compression import compressed
from altd.publish.http.diagnostics import Diagnostics
from altd.publish.http.errors import Refused, refusal
from altd.publish.http.guard import Guard, session_cookie
from altd.publish.http.metrics import CONTENT_TYPE, Metrics
from altd.publish.http.models import Alive, Error, Login, Ready, Session
from altd.publish.http.past import Past
from altd.publish.http.pictures import Viewers
from altd.publish.http.reasons_page import reasons_page
from altd.publish.http.recordings import Downloads, Recordings, head_of
from altd.publish.http.stream import EventStream, Resuming, Streams
from altd.reasons import Reason
from altd.records import Quantities, Quantity
from altd.status.health import Component
from altd.status.measurement_json import checked_line
from altd.status.models import SelfCheck, self_check_of, status_of, targets_of
from altd.status.proof import Stamps
from altd.status.services import SelfCheckService
from altd.status.unit import PublishedUnit

_FOLDER = Path(__file__).with_name("page_files")

_TYPES = {".js": "text/javascript", ".css": "text/css"}
"""Media types of the served files, by suffix; licences and HTML are not among these files."""

_LATE = "vendor/uPlot.iife.min.js", "screen.js"
"""Scripts that the page does not load at once: of the plots, and of another page."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content Security Policy 3: the page runs and loads only the files and responses of its own unit."""


@dataclass(frozen=True, slots=True)
class PageFile:
    """A served file of the page."""

    media_type: str
    content: bytes
    packed: bytes
    """Content as gzip."""


@dataclass(frozen=True, slots=True)
class Description:
    """The OpenAPI document as JSON, and the page made from it."""

    document: bytes
    page: str


def page_of(quantities: Quantities) -> str:
    """Return the HTML of the page, which shows numbers with one decimal fewer than the JSON."""
    page = (_FOLDER / "index.html").read_text(encoding="utf-8")
    document = json.dumps([_facts(quantity, quantities) for quantity in quantities.of_unit])
    scripts = [name for name in page_files() if name.endswith(".js") and name not in _LATE]
    early = "".join(f'<link rel="modulepreload" href="page/{name}">\n' for name in scripts)
    # only this character can end a script element, in which entities are not decoded
    page = page.replace("{/* quantities */}", document.replace("<", "\\u003c"))
    return page.replace("</head>", early + "</head>")


def page_files() -> Mapping[str, PageFile]:
    """Return the page's scripts and styles, by their paths below ``/page/``."""
    return {
        path.relative_to(_FOLDER).as_posix(): PageFile(
            _TYPES[path.suffix], path.read_bytes(), gzip.compress(path.read_bytes())
        )
        for path in sorted(_FOLDER.rglob("*"))
        if path.suffix in _TYPES
    }


def _facts(quantity: Quantity, quantities: Quantities) -> dict[str, object]:
    return {
        "key": quantity.key,
        "label": quantity.label,
        "unit": quantity.unit,
        "meaning": quantity.meaning,
        "decimals": quantity.decimals - 1,
        "is_also": quantity.is_also,
        "point": quantity.point,
        "is_shown": quantity in quantities.shown,
        "has_motion": quantities.has_motion,
    }


API_PAGE_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Content Security Policy of the API page, which loads nothing and runs nothing."""

NOTHING_YET = Error(
    error="nothing was measured since the unit started; /api/status has the reason",
    status=[str(Reason.WARMING_UP)],
)

MAX_BODY_BYTES = 4096
BODY_TIMEOUT_S = 10.0
"""Time limit for receiving the body of a request."""


class Answers:
    """Handlers of one interface, its own and those of its parts. ``guard`` checks permissions.

    ``description`` is made beforehand: to make it for a request would block the loop for 0.1 s or more.
    """

    def __init__(
        self,
        unit: PublishedUnit,
        component: Component,
        guard: Guard,
        past: Past,
        description: Description,
    ) -> None:
        self._unit = unit
        self._component = component
        self.guard = guard
        self.past = past
        self._stamps = Stamps(unit.board, component.name)
        self._metrics = Metrics(unit)
        self._page = page_of(unit.board.quantities)
        self._reasons = reasons_page(self._page)
        # its own folder serves the page too, before there is a calibration
        screen = (_FOLDER / "screen.html").read_text(encoding="utf-8")
        self._screen = screen.replace('="screen.', '="page/screen.')
        self._page_files = page_files()
        self.streams = Streams(unit.board, component, self._stamps)
        self.self_check = unit.self_check
        self.viewers = Viewers(unit.pictures, component, guard)
        downloads = Downloads()
        self.recordings = Recordings(unit.recordings, guard, downloads)
        self.calibration = LoadedCalibration(unit, guard, downloads)
        self.diagnostics = Diagnostics(unit, past, self._metrics, guard, downloads)
        self._description = description

    async def index(self, _: Request) -> Response:
        """Return the page."""
        return HTMLResponse(self._page, headers={"Content-Security-Policy": POLICY})

    async def reasons(self, _: Request) -> Response:
        """Return the page of all causes."""
        return HTMLResponse(self._reasons, headers={"Content-Security-Policy": POLICY})

    async def screen(self, _: Request) -> Response:
        """Return the page that shows a plate's discs, to calibrate from a screen."""
        return HTMLResponse(self._screen, headers={"Content-Security-Policy": POLICY})

    async def page_file(self, request: Request) -> Response:
        """Return a script or a style of the page."""
        file = self._page_files.get(request.path_params["file"])
        if file is None:
            return refusal(404, "Not Found")
        return compressed(request, Response(file.content, media_type=file.media_type), file.packed)

    async def api(self, _: Request) -> Response:
        """Return the page of the API."""
        return HTMLResponse(self._description.page, headers={"Content-Security-Policy": API_PAGE_POLICY})

    async def openapi(self, _: Request) -> Response:
        """Return the OpenAPI document."""
        return Response(self._description.document, media_type="application/json")

    async def measurement(self, _: Request) -> Response:
        """Return the latest measurement; 503 before the first."""
        measurement = self._unit.board.read()
        if measurement is None:
            return JSONResponse(NOTHING_YET.as_object(), status_code=503)
        self._component.gave_data()
        return Response(
            checked_line(self._unit.board, measurement, self._stamps.next()), media_type="application/json"
        )

    async def status(self, _: Request) -> Response:
        """Return the unit's facts and its components."""
        return JSONResponse(status_of(self._unit.view()).as_object())

    async def targets(self, _: Request) -> Response:
        """Return the areas in which the targets are measured."""
        return JSONResponse(targets_of(self._unit.targets).as_object())

    async def stream(self, request: Request) -> Response:
        """Stream measurements as they are published."""
        if request.method == "HEAD":
            return head_of(EventStream.media_type, EventStream.own_headers)
        return EventStream(self.streams)

    async def resumed_stream(self, request: Request) -> Response:
        """Stream measurements with ids, by which a client resumes the stream."""
        if request.method == "HEAD":
            return head_of(EventStream.media_type, EventStream.own_headers)
        last_id = request.headers.get("Last-Event-ID")
        return EventStream(self.streams, Resuming(None if last_id is None else self.past.since(last_id)))

    async def metrics(self, _: Request) -> Response:
        """Return all metrics for Prometheus."""
        return Response(self._metrics.text(), headers={"Content-Type": CONTENT_TYPE})

    async def alive(self, _: Request) -> Response:
        """Report that the event loop runs; the response itself is the proof."""
        return JSONResponse(Alive(alive=True).as_object())

    async def ready(self, _: Request) -> Response:
        """Report that the unit measures, valid or not; otherwise return 503 with the cause."""
        measurement = self._unit.board.read()
        if measurement is None:
            return refusal(503, self._worst() or "nothing was measured since the unit started")
        if any(fault.reason is Reason.STALE for fault in measurement.status):
            return refusal(503, self._worst() or "no new measurement")
        return JSONResponse(Ready(ready=True).as_object())

    async def log_in(self, request: Request) -> Response:
        """Begin a session; its secret is sent in a cookie that scripts cannot read."""
        try:
            wanted = await _login_of(request)
        except ClientDisconnect:
            return refusal(400, "it ended before its body did")
        secret = await self.guard.log_in(request, wanted.name, wanted.password)
        answer = self._session(wanted.name, may_act=True)
        answer.headers["Set-Cookie"] = session_cookie(request, secret)
        return answer

    async def log_out(self, request: Request) -> Response:
        """End the session, if there is one."""
        self.guard.log_out(request)
        answer = self._session(None, may_act=False)
        answer.headers["Set-Cookie"] = session_cookie(request, "")
        return answer

    async def session(self, request: Request) -> Response:
        """Return the name of the logged-in user, and whether the client may act."""
        return self._session(self.guard.viewer(request), may_act=self.guard.may_act(request))

    def _session(self, name: str | None, *, may_act: bool) -> Response:
        shown = Session(name=name, may_act=may_act, login=self.guard.has_credentials)
        return JSONResponse(shown.as_object())

    def _worst(self) -> str:
        """Return a text for the worst cause; empty if the unit's state is unknown or has no cause."""
        causes = self._unit.view().causes
        if not causes:
            return ""
        cause = causes[0].cause
        return cause.kind.brief + (f" ({cause.of})" if cause.of else "")


async def self_check(request: Request, service: SelfCheckService, guard: Guard) -> Response:
    """Return the report of the last check; a POST makes a new one first, for clients that may act."""
    if request.method != "POST":
        if service.latest is None:
            why = service.unavailable or "there was no self-check since the unit started"
            none = SelfCheck(verdict=None, reasons=[why], unavailable=service.unavailable)
            return JSONResponse(none.as_object())
        return JSONResponse(self_check_of(service.latest.check, service.latest).as_object())
    by = guard.requester(request)
    if service.waiting >= MAX_WAITING:
        return refusal(503, f"{service.waiting} wait for a self-check already; /api/self-check has it soon")
    number = service.ask(by)
    try:
        async with asyncio.timeout(SELF_CHECK_WAIT_S):
            report = await service.report(number)
    except TimeoutError:
        why = f"the self-check has not ended within {SELF_CHECK_WAIT_S:g} s; /api/status has the reason"
        return refusal(504, why)
    return JSONResponse(self_check_of(report.check, report).as_object())


async def _login_of(request: Request) -> Login:
    """Return name and password of a request; raises Refused."""
    kind = request.headers.get("Content-Type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise Refused(refusal(415, "the body must be application/json"))
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            return Login.model_validate_json(await _body_of(request), strict=True)
    except ValidationError as error:  # the response does not repeat the input
        raise Refused(refusal(400, "the body must be an object with only name and password")) from error
    except TimeoutError as error:
        raise Refused(refusal(408, "its body did not come")) from error


async def _body_of(request: Request) -> bytes:
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > MAX_BODY_BYTES:
            raise Refused(refusal(413, f"its body is longer than {MAX_BODY_BYTES} bytes"))
    return body
