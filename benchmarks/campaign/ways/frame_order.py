"""Ways that change the order of whole frames: repeated, frozen, late or exchanged pictures."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.campaign.way import CAMERAS, Draw, Registry, Shot, Spoil, showing

WAYS = Registry("frames")


def _pixels_from(
    cameras: frozenset[str], source: Callable[[int, int], int]
) -> Callable[[list[Shot], int], list[Shot]]:
    """A stream in which exposure k of some cameras shows the picture of exposure ``source(k, onset)``."""

    def stream(shots: list[Shot], onset: int) -> list[Shot]:
        first = min(shot.k for shot in shots)

        def shown(shot: Shot) -> tuple[str, int]:
            return shot.camera, max(source(shot.k, onset), first) if shot.camera in cameras else shot.k

        return showing(shots, onset, shown)

    return stream


@WAYS.add(moving=True)
def frozen(draw: Draw) -> Spoil:
    """The same picture with new numbers and times."""
    cameras = draw.targets()
    return Spoil(" and ".join(sorted(cameras)), stream=_pixels_from(cameras, lambda k, onset: onset - 1))


@WAYS.add(moving=True)
def loop(draw: Draw) -> Spoil:
    """The last pictures before the onset, repeated."""
    length, cameras = draw.whole(2, 4), draw.targets()
    source = lambda k, onset: onset - length + (k - onset) % length  # noqa: E731
    return Spoil(f"of {length} frames", stream=_pixels_from(cameras, source))


@WAYS.add(moving=True)
def every_second_repeated(draw: Draw) -> Spoil:
    """Every second frame repeats the one before."""
    cameras = draw.targets()
    return Spoil(
        " and ".join(sorted(cameras)),
        stream=_pixels_from(cameras, lambda k, onset: k - (k - onset) % 2),
    )


@WAYS.add(
    moving=True,
    invisible="one late camera differs from a yaw only by the machine's vibration, which takes some 5 s to "
    "detect; until then speed × delay: up to 0.75 mm at 5 mm/s and three frames",
)
def one_camera_late(draw: Draw) -> Spoil:
    """One camera shows frames of the past with current number and time."""
    late, cameras = draw.whole(1, 3), draw.one()
    return Spoil(f"{', '.join(cameras)} {late} late", stream=_pixels_from(cameras, lambda k, onset: k - late))


@WAYS.add(
    moving=True,
    invisible="frames that are late from both cameras with current stamps are a steady delay: 50 to 150 ms, "
    "up to 1 mm at 5 mm/s",
)
def both_cameras_late(draw: Draw) -> Spoil:
    """Both cameras show frames of the past with current number and time."""
    late = draw.whole(1, 3)
    return Spoil(f"{late} late", stream=_pixels_from(frozenset(CAMERAS), lambda k, onset: k - late))


@WAYS.add(moving=True)
def played_backwards(draw: Draw) -> Spoil:
    """Pairs of pictures in exchanged order."""
    cameras = draw.targets()
    source = lambda k, onset: k + 1 - 2 * ((k - onset) % 2)  # noqa: E731
    return Spoil(" and ".join(sorted(cameras)), stream=_pixels_from(cameras, source))
