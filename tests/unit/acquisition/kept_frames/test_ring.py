"""The ring keeps the newest frames within its bounds."""

from dataclasses import dataclass, field

import numpy as np

from altd.acquisition.kept_frames.ring import FrameRing
from altd.records import CameraIdentity, Frame

PERIOD_NS = 50_000_000
PIXELS = np.zeros((10, 100), np.uint8)


@dataclass
class Fed:
    """A ring of two cameras."""

    max_bytes: int = 1 << 20
    length_s: float = 1.0
    identities: dict[str, CameraIdentity | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ring = FrameRing(self.max_bytes, round(self.length_s * 1e9), self.identities.get)

    def put(self, *numbers: int) -> None:
        for number in numbers:
            for camera in ("front", "rear"):
                self.ring.keep(Frame(camera, number, number * PERIOD_NS, PIXELS))

    def kept(self, since: int = -(10**9), until: int = 10**9) -> list[tuple[str, int]]:
        frames = self.ring.between(since * PERIOD_NS, until * PERIOD_NS)
        return [(frame.camera, frame.sequence) for frame in frames]


def both(*numbers: int) -> list[tuple[str, int]]:
    return [(camera, number) for number in numbers for camera in ("front", "rear")]


def test_it_reaches_back_as_far_as_it_is_long() -> None:
    fed = Fed(length_s=1.0)
    fed.put(*range(100))
    assert fed.kept() == both(*range(79, 100))
    assert fed.ring.nbytes == 42 * PIXELS.nbytes


def test_it_takes_no_more_memory_than_it_may() -> None:
    fed = Fed(max_bytes=7 * PIXELS.nbytes + 1)
    fed.put(*range(100))
    assert fed.kept() == [("rear", 96), *both(97, 98, 99)]
    assert fed.ring.nbytes == 7 * PIXELS.nbytes


def test_a_frame_larger_than_the_ring_is_not_kept() -> None:
    fed = Fed(max_bytes=PIXELS.nbytes - 1)
    fed.put(1)
    assert fed.kept() == []
    assert fed.ring.nbytes == 0


def test_a_span_is_taken_out() -> None:
    fed = Fed()
    fed.put(*range(20))
    assert fed.kept(5, 7) == both(5, 6, 7)
    assert fed.kept(30, 40) == []


def test_what_is_played_again_does_not_follow_what_was_played_before() -> None:
    fed = Fed(length_s=1.0)
    fed.put(*range(50))
    fed.put(0, 1)
    assert fed.kept() == both(0, 1)


def test_frames_of_a_camera_that_was_exchanged_are_not_mixed_with_those_of_the_new_one() -> None:
    fed = Fed()
    fed.identities["front"] = fed.identities["rear"] = CameraIdentity("1")
    fed.put(1, 2)
    fed.identities["rear"] = CameraIdentity("2")
    fed.put(3)
    assert fed.kept() == [("front", 1), ("front", 2), *both(3)]
