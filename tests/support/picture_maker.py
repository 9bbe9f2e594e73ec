"""A maker of pictures behind the picture service that gives what a test puts into it."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from altd.status.services import NoPictureError, Picture, SpotContour, TargetView

AXES = (375.0, 240.0), (-4.0, 0.0), (0.0, -4.0)
VIEWS = (
    TargetView("front", "left", 752, 480, ((1.0, 2.0), (3.0, 4.0)), ((5.0, 6.0),), *AXES),
    TargetView("rear", "right", 752, 480, (), (), *AXES),
)
SPOT = SpotContour(200.123, 100.5, 22.0, 21.0, -30.0)


def picture(target: str, number: int, **about: Any) -> Picture:
    values: dict[str, Any] = {"sequence": 100 + number, "t_ns": 8_000_000_000, "width": 752, "height": 480}
    values |= {"spot": SPOT, "why": "", "leds_on": False, "jpeg": b"\xff\xd8" + target.encode() * number}
    return Picture(target, number, **values | about)


@dataclass
class Maker:
    """Gives what a test puts into it."""

    views: Sequence[TargetView] = VIEWS
    newest: dict[str, Picture] = field(default_factory=dict)
    asked: list[dict[str, int]] = field(default_factory=list)
    fails: str = ""

    def put(self, *newest: Picture) -> None:
        self.newest |= {each.target: each for each in newest}

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        self.asked.append(dict(seen))
        while True:
            if self.fails:
                raise NoPictureError(self.fails)
            if ready := [each for each in self.newest.values() if each.number > seen.get(each.target, 0)]:
                return ready
            await asyncio.sleep(0.005)
