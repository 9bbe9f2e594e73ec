"""Compression of answers that are text, for clients that accept it: the page comes sooner on a slow link."""

import gzip

from starlette.requests import Request
from starlette.responses import Response

MIN_BYTES = 1000
"""Size from which an answer is compressed, B; a smaller one fits into one packet."""

_TEXTS = ("text/", "application/json")


def compressed(request: Request, response: Response, packed: bytes | None = None) -> Response:
    """Return a response with its body as gzip, if it is text and the client accepts that.

    ``packed`` is the body as gzip; None: it is made now, fast. Streams, which have no body, stay as they are.
    """
    body, headers = getattr(response, "body", b""), response.headers
    is_text = headers.get("Content-Type", "").startswith(_TEXTS) and "Content-Encoding" not in headers
    if len(body) >= MIN_BYTES and is_text:
        headers.add_vary_header("Accept-Encoding")
        if _accepts_gzip(request.headers.get("Accept-Encoding", "")):
            response.body = gzip.compress(body, 1, mtime=0) if packed is None else packed
            headers["Content-Encoding"], headers["Content-Length"] = "gzip", str(len(response.body))
    return response


def _accepts_gzip(accepted: str) -> bool:
    """Whether a client accepts gzip (RFC 9110, 12.5.3); one that weighs it ``q=0`` does not."""
    weights = dict(coding.replace(" ", "").partition(";q=")[::2] for coding in accepted.lower().split(","))
    return weights.get("gzip", "0").strip("0.") != "" or weights.get("gzip") == ""
