"""Served paths with their methods: application, OpenAPI document and docs are made from this table."""

from __future__ import annotations

from dataclasses import replace

from altd.publish.http import models
from altd.publish.http.answers import Answers, self_check
from altd.publish.http.calibration import CalibrationFile
from altd.publish.http.diagnostics import ZIP
from altd.publish.http.operations import Operation, Parameter, ServedPath
from altd.publish.http.past import EVENTS, LAST_S, MAX_EVENTS, MAX_POINTS, POINTS
from altd.status import models as unit
from altd.status.calibration_summary import CalibrationSummary
from altd.status.event_log import EventKind
from altd.status.services import KeptRecording

HTML = "text/html"
EVENT_STREAM = "text/event-stream"
TEXT = "text/plain"

ALIVE = "/healthz"
"""Path of the liveness check, which accepts any name in ``Host``."""

_KINDS = {"type": "string", "enum": [str(kind) for kind in EventKind]}
_SECONDS = {"type": "number", "minimum": -LAST_S, "maximum": LAST_S}

_NOT_ALLOWED = {
    401: "the token or the session is missing, unknown or over",
    403: "the client may not do this, or the request comes from a page that is not the unit's own",
}

_MEASUREMENT = {
    "GET": Operation(
        Answers.measurement,
        "The latest measurement",
        "measurement",
        errors={503: "nothing was measured since the unit started; `status` has the codes of the reasons"},
    )
}
_STATUS = {"GET": Operation(Answers.status, "The unit, its state and its components", unit.Status)}
_SELF_CHECK = {
    "GET": Operation(
        lambda to, request: self_check(request, to.self_check, to.guard),
        "The result of the last self-check",
        unit.SelfCheck,
    ),
    "POST": Operation(
        lambda to, request: self_check(request, to.self_check, to.guard),
        "Make a self-check and return its result",
        unit.SelfCheck,
        errors={
            **_NOT_ALLOWED,
            409: "the unit cannot check itself",
            503: "too many wait for one already",
            504: "the check has not ended in time",
        },
        acts=True,
        needs_actor=True,
    ),
}
_STREAM = {
    "GET": Operation(
        Answers.stream,
        "Every measurement as a server-sent event",
        media_type=EVENT_STREAM,
        errors={503: "enough streams are open already"},
    )
}

_RESUMED_STREAM = {"GET": replace(_STREAM["GET"], handler=Answers.resumed_stream)}
_SPAN = (
    Parameter("from", "Since when: seconds since 1970, UTC; negative: before now.", _SECONDS),
    Parameter("to", "Until when, likewise; default now.", _SECONDS),
)
_NO_HISTORY = {
    400: "a parameter that cannot be",
    503: "the history cannot be read now, or this unit has none",
}
_TREND = Operation(
    lambda to, request: to.past.trend(request),
    "Each quantity over time: mean, sigma, lowest and highest",
    models.Trend,
    errors=_NO_HISTORY,
    query=(
        *_SPAN,
        Parameter(
            "points",
            f"Maximum number; default {POINTS}.",
            {"type": "integer", "minimum": 1, "maximum": MAX_POINTS},
        ),
    ),
)
_EVENTS = Operation(
    lambda to, request: to.past.events(request),
    "Events of the unit",
    models.Events,
    errors=_NO_HISTORY,
    query=(
        *_SPAN,
        Parameter("kind", "Of this kind only.", _KINDS),
        Parameter(
            "limit",
            f"Maximum number; default {EVENTS}.",
            {"type": "integer", "minimum": 1, "maximum": MAX_EVENTS},
        ),
        Parameter(
            "before",
            "An `id`: only those that are older, for the next page.",
            {"type": "integer", "minimum": 0, "maximum": 2**53},
        ),
    ),
)

_RECORDING_NAME = Parameter(
    "name", "As the list has it.", {"type": "string", "pattern": "^[0-9A-Za-z_-]{1,120}$"}, is_in_path=True
)
_NO_RECORDING = {404: "there is no such recording", 409: "disabled on this unit, or not possible now"}
_RECORDINGS = {
    "GET": Operation(
        lambda to, request: to.recordings.listed(request),
        "The recordings that the unit has kept",
        models.Recordings,
    ),
    "POST": Operation(
        lambda to, request: to.recordings.keep(request),
        "Keep the frames of the last seconds as a recording",
        KeptRecording,
        status=201,
        errors={**_NOT_ALLOWED, 409: "disabled on this unit, or not possible now"},
        acts=True,
        needs_actor=True,
    ),
}
_MARK = Operation(
    lambda to, request: to.recordings.mark(request),
    "Mark a recording, so that it is never removed to make room",
    KeptRecording,
    errors={**_NOT_ALLOWED, **_NO_RECORDING},
    query=(_RECORDING_NAME,),
    acts=True,
    needs_actor=True,
)

_NO_DOWNLOAD = {401: _NOT_ALLOWED[401], 503: "enough downloads are under way already"}
_NO_CALIBRATION = "there is no calibration"
_CALIBRATION_FILES = (
    ServedPath(
        "/api/v1/calibration",
        "figures of the loaded calibration",
        {
            "GET": Operation(
                lambda to, request: to.calibration.summary(request),
                "The loaded calibration, its origin and its accuracy",
                CalibrationSummary,
                errors={503: _NO_CALIBRATION},
            )
        },
    ),
    ServedPath(
        "/api/v1/calibration/file",
        "its file as it was loaded, for `altd replay`",
        {
            "GET": Operation(
                lambda to, request: to.calibration.file(request),
                "The calibration file as it was loaded",
                CalibrationFile,
                errors={
                    **_NO_DOWNLOAD,
                    409: "the file cannot be read, or is another one than the unit has loaded",
                },
            )
        },
    ),
    ServedPath(
        "/api/v1/calibration/report",
        "the report on it, in HTML",
        {
            "GET": Operation(
                lambda to, request: to.calibration.report(request),
                "The report on the loaded calibration",
                media_type=HTML,
                errors={**_NO_DOWNLOAD, 404: "there is no report on the loaded calibration"},
            )
        },
    ),
)
_DIAGNOSTICS = ServedPath(
    "/api/v1/diagnostics",
    "a zip archive for remote diagnostics",
    {
        "GET": Operation(
            lambda to, request: to.diagnostics.archive(request),
            "All of it, for remote diagnostics",
            media_type=ZIP,
            errors=_NO_DOWNLOAD,
        )
    },
)

PATHS = (
    ServedPath(
        "/", "the page in a browser", {"GET": Operation(Answers.index, "The unit's page", media_type=HTML)}
    ),
    ServedPath(
        "/reasons",
        "each cause in words, with its remedy; `#CODE` is its place",
        {"GET": Operation(Answers.reasons, "The page of all causes", media_type=HTML)},
    ),
    ServedPath("/api/measurement", "the latest measurement", _MEASUREMENT),
    ServedPath("/api/status", "the unit, its state and causes, availability, components", _STATUS),
    ServedPath("/api/self-check", "the last self-check; `POST`: makes one now", _SELF_CHECK),
    ServedPath("/api/stream", "every new measurement, as server-sent events", _STREAM),
    ServedPath(
        "/api/v1/",
        "a page that explains the API",
        {"GET": Operation(Answers.api, "The page of the API", media_type=HTML)},
    ),
    ServedPath(
        "/api/v1/openapi.json",
        "the API as an OpenAPI 3.1 document",
        {"GET": Operation(Answers.openapi, "This document", models.Document)},
    ),
    ServedPath("/api/v1/measurement", "as `/api/measurement`", _MEASUREMENT),
    ServedPath("/api/v1/status", "as `/api/status`", _STATUS),
    ServedPath(
        "/api/v1/targets",
        "the targets, and the outline of valid spots on each",
        {"GET": Operation(Answers.targets, "The targets and their areas", unit.Targets)},
    ),
    ServedPath("/api/v1/self-check", "as `/api/self-check`", _SELF_CHECK),
    ServedPath("/api/v1/stream", "as `/api/stream`, and resumes", _RESUMED_STREAM),
    ServedPath("/api/v1/trend", "the course of each quantity", {"GET": _TREND}),
    ServedPath("/api/v1/events", "events of the unit, the newest first", {"GET": _EVENTS}),
    ServedPath(
        "/api/v1/recordings", "kept recordings of frames; `POST`: keeps the last seconds now", _RECORDINGS
    ),
    ServedPath(
        "/api/v1/recordings/{name}",
        "one of them as a tar archive, for `altd replay`",
        {
            "GET": Operation(
                lambda to, request: to.recordings.archive(request),
                "A recording as a tar archive",
                media_type="application/x-tar",
                errors={**_NO_DOWNLOAD, **_NO_RECORDING},
                query=(_RECORDING_NAME,),
            )
        },
    ),
    ServedPath(
        "/api/v1/recordings/{name}/mark",
        "`PUT`: protects it from removal; `DELETE`: ends that",
        {"PUT": _MARK, "DELETE": replace(_MARK, summary="Take the mark of a recording away")},
    ),
    *_CALIBRATION_FILES,
    _DIAGNOSTICS,
    ServedPath(
        "/api/v1/session",
        "the user who is logged in, and whether acting is allowed",
        {"GET": Operation(Answers.session, "The user who is logged in", models.Session)},
    ),
    ServedPath(
        "/api/v1/login",
        "`POST` name and password: begins a session",
        {
            "POST": Operation(
                Answers.log_in,
                "Log in: begins a session and sets its cookie",
                models.Session,
                takes=models.Login,
                errors={
                    **_NOT_ALLOWED,
                    401: "name or password is wrong",
                    408: "the body did not come",
                    409: "logging in is not possible here: no credentials are set",
                    413: "the body is too long",
                    415: "the body is not application/json",
                },
                acts=True,
            )
        },
    ),
    ServedPath(
        "/api/v1/logout",
        "`POST`: ends the session",
        {
            "POST": Operation(
                Answers.log_out, "Log out", models.Session, errors={403: _NOT_ALLOWED[403]}, acts=True
            )
        },
    ),
    ServedPath(
        "/metrics",
        "all numbers for Prometheus",
        {"GET": Operation(Answers.metrics, "All numbers for Prometheus", media_type=TEXT)},
    ),
    ServedPath(
        ALIVE,
        "200 while the daemon answers",
        {"GET": Operation(Answers.alive, "Whether the daemon answers", models.Alive)},
    ),
    ServedPath(
        "/readyz",
        "200 while the unit measures, valid or not; else 503 with the reason",
        {
            "GET": Operation(
                Answers.ready,
                "Whether the unit measures",
                models.Ready,
                errors={503: "nothing has been measured yet, or there is no new measurement"},
            )
        },
    ),
)
"""All served paths, in the order of ``docs/http.md``."""
