"""Pictures of which everybody can say whether they are the right ones."""

import asyncio
import json
import time
from collections.abc import Sequence

from altd.status.services import Picture, TargetView

PATH = "/api/v1/pictures"

_RATE_HZ = 20
_AXES = (375.0, 240.0), (-4.0, 0.0), (0.0, -4.0)
_TARGETS = "front", "rear"


class Maker:
    """A picture of each target twenty times a second (``altd.status.services.PictureMaker``)."""

    views = tuple(TargetView(name, name, 752, 480, (), (), *_AXES) for name in _TARGETS)

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        """The pictures of this twentieth of a second."""
        last = max(seen.values(), default=0)
        await asyncio.sleep(max((last + 1) / _RATE_HZ - time.monotonic(), 0.0))
        number = max(int(time.monotonic() * _RATE_HZ), last + 1)
        t_ns = time.monotonic_ns()
        return [
            Picture(name, number, number, t_ns, 752, 480, None, "", False, _jpeg(name, number))
            for name in _TARGETS
        ]


def complaint_of_views(text: bytes) -> str:
    """The fault of the first message; empty: none."""
    views = json.loads(text)["views"]
    return "" if [each["target"] for each in views] == list(_TARGETS) else f"other views: {text[:80]!r}"


def complaint_of_pictures(message: bytes) -> str:
    """The fault of a message of pictures; empty: none."""
    end = 4 + int.from_bytes(message[:4], "big")
    rest = message[end:]
    for each in json.loads(message[4:end])["pictures"]:
        if rest[: each["bytes"]] != _jpeg(each["target"], each["sequence"]):
            return f"another picture than it says: {message[:200]!r}"
        rest = rest[each["bytes"] :]
    return "" if rest == b"" else "more than the pictures"


def _jpeg(target: str, number: int) -> bytes:
    """As long as a small picture; no JPEG, which no client here decodes."""
    return f"{target} {number} ".encode() * 1000
