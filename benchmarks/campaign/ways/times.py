"""Ways with wrong times and numbers of frames, and with a process that was held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from benchmarks.campaign.way import CAMERAS, Draw, Way

MS, S = 1_000_000, 1_000_000_000
PERIOD_NS = 50 * MS


@dataclass(frozen=True, slots=True)
class Delivery:
    """A frame in transfer: its exposure time ``true_ns``, its number and stamp, and its arrival."""

    camera: str
    true_ns: int
    sequence: int
    t_ns: int
    arrives_ns: int


Change = Callable[[list[Delivery], int], list[Delivery]]


@dataclass(frozen=True, slots=True)
class Mistimed:
    """One way with its parameters drawn.

    ``change`` converts the deliveries of a run, whose disturbance begins at ``onset_ns``, to the actual
    arrivals. It is over ``end_ns`` after the onset, None: never. ``held_ns``: duration for which the process
    is stopped. ``own_clock``: the stamps are from a clock in the camera, as for a GigE camera, and the driver
    maps them; otherwise they are from the host's clock, as for a V4L2 camera.
    """

    note: str
    change: Change
    pair_by: Literal["sequence", "time"]
    end_ns: int | None = None
    held_ns: int = 0
    own_clock: bool = False


WAYS: list[Way] = []

_One = Callable[[Delivery], Delivery]


_STEADY_DELAY = (
    "one camera that lags steadily by up to a second and stamps on arrival differs from a yaw only by the "
    "machine's vibration: speed × delay, up to 4 mm at 4 mm/s"
)


def _entered(
    own_clock: Callable[[Draw], bool], invisible: str = ""
) -> Callable[[Callable[[Draw], Mistimed]], Callable[[Draw], Mistimed]]:
    """Decorator that registers a way of times or numbers; ``own_clock``: whether a camera's clock stamps."""

    def enter(make: Callable[[Draw], Mistimed]) -> Callable[[Draw], Mistimed]:
        def of_camera(draw: Draw) -> Mistimed:
            return replace(make(draw), own_clock=own_clock(draw))

        of_camera.__doc__ = make.__doc__
        WAYS.append(Way(make.__name__, "times", of_camera, invisible=invisible))
        return make

    return enter


_enter = _entered(lambda draw: bool(draw.rng.random() < 0.5))
_of_a_clock = _entered(lambda draw: True)
"""Registers faults of a clock in the camera only: a V4L2 camera is stamped by the kernel of the host."""


def _each(change: _One, cameras: frozenset[str], length_ns: int | None) -> Change:
    """Change the frames of some cameras from the onset on, for this duration."""

    def changed(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        def of(one: Delivery) -> Delivery:
            since_ns = one.true_ns - onset_ns
            meant = one.camera in cameras and since_ns >= 0 and (length_ns is None or since_ns < length_ns)
            return change(one) if meant else one

        return [of(one) for one in deliveries]

    return changed


def _pairing(draw: Draw) -> Literal["sequence", "time"]:
    return "time" if draw.rng.random() < 0.75 else "sequence"


def _names(cameras: frozenset[str]) -> str:
    return " and ".join(sorted(cameras))


def _far_ns(draw: Draw) -> int:
    return round(draw.log(0.02, 7200.0) * S)


@_enter
def clean_times(draw: Draw) -> Mistimed:
    """No disturbance."""
    return Mistimed("nothing disturbed", lambda deliveries, onset_ns: deliveries, _pairing(draw), 0)


def _one_stamp(draw: Draw, sign: int) -> Mistimed:
    far_ns, cameras = _far_ns(draw), draw.targets()
    change = _each(lambda one: replace(one, t_ns=one.t_ns + sign * far_ns), cameras, PERIOD_NS)
    return Mistimed(f"by {far_ns / S:.2f} s, {_names(cameras)}", change, _pairing(draw), PERIOD_NS)


@_enter
def stamp_ahead(draw: Draw) -> Mistimed:
    """One frame, of one camera or both, has a later time stamp."""
    return _one_stamp(draw, 1)


@_enter
def stamp_back(draw: Draw) -> Mistimed:
    """One frame has an earlier time stamp."""
    return _one_stamp(draw, -1)


@_of_a_clock
def clock_steps(draw: Draw) -> Mistimed:
    """The clock of one camera or both jumps."""
    far_ns, cameras = draw.sign() * _far_ns(draw), draw.targets()
    change = _each(lambda one: replace(one, t_ns=one.t_ns + far_ns), cameras, None)
    return Mistimed(f"by {far_ns / S:+.2f} s, {_names(cameras)}", change, _pairing(draw))


def _stuck(draw: Draw, as_first: Callable[[Delivery, Delivery], Delivery]) -> Mistimed:
    """Let frames repeat the number or the stamp of the first one for a while."""
    length_ns, cameras = draw.whole(2, 40) * PERIOD_NS, draw.targets()

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        first = next(one for one in deliveries if one.true_ns >= onset_ns)
        return _each(lambda one: as_first(one, first), cameras, length_ns)(deliveries, onset_ns)

    return Mistimed(f"for {length_ns / S:.2f} s", change, _pairing(draw), length_ns)


@_enter
def stamps_stuck(draw: Draw) -> Mistimed:
    """The time stamps of a camera repeat for a while."""
    return _stuck(draw, lambda one, first: replace(one, t_ns=first.t_ns))


@_enter
def stamps_zero(draw: Draw) -> Mistimed:
    """The time stamps of a camera are 0."""
    length_ns, cameras = draw.whole(1, 20) * PERIOD_NS, draw.targets()
    return Mistimed(
        f"for {length_ns / S:.2f} s",
        _each(lambda one: replace(one, t_ns=0), cameras, length_ns),
        _pairing(draw),
        length_ns,
    )


@_enter
def stamps_jitter(draw: Draw) -> Mistimed:
    """The time stamps of a camera jitter."""
    sigma_ns, cameras, rng = draw.log(1, 60) * MS, draw.targets(), draw.rng
    change = _each(lambda one: replace(one, t_ns=one.t_ns + round(rng.normal(0, sigma_ns))), cameras, None)
    return Mistimed(f"by {sigma_ns / MS:.0f} ms", change, _pairing(draw))


def _rated(draw: Draw, rate: float, words: str) -> Mistimed:
    cameras = draw.targets()

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        def faster(one: Delivery) -> Delivery:
            return replace(one, t_ns=one.t_ns + round(rate * (one.true_ns - onset_ns)))

        return _each(faster, cameras, None)(deliveries, onset_ns)

    return Mistimed(f"{words}, {_names(cameras)}", change, _pairing(draw))


@_of_a_clock
def stamps_doubled(draw: Draw) -> Mistimed:
    """Time stamps in a wrong unit: twice or half the rate."""
    rate = 1.0 if draw.sign() > 0 else -0.5
    return _rated(draw, rate, f"{1 + rate:g} times as fast")


@_of_a_clock
def clock_drifts(draw: Draw) -> Mistimed:
    """A camera's clock drifts by 0.01 to 20 %."""
    rate = draw.sign() * draw.log(1e-4, 0.2)
    return _rated(draw, rate, f"{rate:+.2%}")


def _renumbered(draw: Draw, by: int, length_ns: int | None) -> Mistimed:
    cameras = draw.targets()
    change = _each(lambda one: replace(one, sequence=max(one.sequence + by, 0)), cameras, length_ns)
    return Mistimed(f"by {by:+d}, {_names(cameras)}", change, _pairing(draw), length_ns)


@_enter
def numbers_jump(draw: Draw) -> Mistimed:
    """The frame numbers jump and continue from there."""
    return _renumbered(draw, draw.sign() * round(draw.log(1, 5000)), None)


@_enter
def number_once(draw: Draw) -> Mistimed:
    """One frame has a wrong number."""
    return _renumbered(draw, draw.sign() * round(draw.log(1, 1e9)), PERIOD_NS)


@_enter
def numbers_stuck(draw: Draw) -> Mistimed:
    """The frame numbers repeat for a while."""
    return _stuck(draw, lambda one, first: replace(one, sequence=first.sequence))


@_enter
def process_held(draw: Draw) -> Mistimed:
    """The process is stopped and continued; frames buffered by the drivers arrive first."""
    held_ns, kept = round(draw.log(0.2, 12.0) * S), draw.whole(0, 8)

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        arrived = [one for one in deliveries if not 0 <= one.true_ns - onset_ns < held_ns]
        held = [one for one in deliveries if 0 <= one.true_ns - onset_ns < held_ns]
        for camera in CAMERAS:
            waiting = [one for one in held if one.camera == camera]
            arrived += [replace(one, arrives_ns=onset_ns + held_ns) for one in waiting[:kept]]
        return arrived

    return Mistimed(f"{held_ns / S:.1f} s, {kept} frames kept", change, _pairing(draw), held_ns, held_ns)


@_enter
def frames_delayed(draw: Draw) -> Mistimed:
    """Frames of one camera or both arrive late with true time stamps."""
    late_ns, cameras = round(draw.log(0.05, 4.0) * S), draw.targets()
    length_ns = draw.whole(1, 40) * PERIOD_NS
    change = _each(lambda one: replace(one, arrives_ns=one.arrives_ns + late_ns), cameras, length_ns)
    return Mistimed(
        f"by {late_ns / S:.2f} s for {length_ns / S:.2f} s", change, _pairing(draw), length_ns + late_ns
    )


@_entered(lambda draw: False, _STEADY_DELAY)
def delayed_and_stamped_on_arrival(draw: Draw) -> Mistimed:
    """Frames arrive up to a second late and are stamped on arrival."""
    late_ns, cameras = round(draw.log(0.05, 1.0) * S), draw.one()
    change = _each(
        lambda one: replace(one, arrives_ns=one.arrives_ns + late_ns, t_ns=one.t_ns + late_ns), cameras, None
    )
    return Mistimed(f"by {late_ns / S:.2f} s, {' and '.join(cameras)}", change, "time")


@_enter
def bursts(draw: Draw) -> Mistimed:
    """Frames arrive in groups."""
    size, cameras = draw.whole(2, 12), draw.targets()

    def together(one: Delivery) -> Delivery:
        step = size * PERIOD_NS
        return replace(one, arrives_ns=-(-one.arrives_ns // step) * step)

    return Mistimed(f"of {size}", _each(together, cameras, None), _pairing(draw))


@_enter
def out_of_order(draw: Draw) -> Mistimed:
    """Neighbouring frames of a camera arrive in exchanged order."""
    cameras = draw.targets()

    def later(one: Delivery) -> Delivery:
        return replace(one, arrives_ns=one.arrives_ns + (3 * PERIOD_NS // 2 if one.sequence % 2 else 0))

    return Mistimed(_names(cameras), _each(later, cameras, None), _pairing(draw))


def _without(is_lost: Callable[[Delivery, int], bool]) -> Change:
    """Omit the frames selected by ``is_lost``, which gets the time of exposure since the onset, ns."""

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        return [one for one in deliveries if not is_lost(one, one.true_ns - onset_ns)]

    return change


@_enter
def frames_lost(draw: Draw) -> Mistimed:
    """Some frames never arrive."""
    share, cameras, rng = draw.uniform(0.02, 0.9), draw.targets(), draw.rng

    change = _without(lambda one, since_ns: since_ns >= 0 and one.camera in cameras and rng.random() < share)
    return Mistimed(f"{share:.0%}, {_names(cameras)}", change, _pairing(draw))


@_enter
def camera_silent(draw: Draw) -> Mistimed:
    """One camera or both deliver nothing for a while."""
    length_ns, cameras = round(draw.log(0.1, 4.0) * S), draw.targets()

    change = _without(lambda one, since_ns: one.camera in cameras and 0 <= since_ns < length_ns)
    return Mistimed(f"for {length_ns / S:.2f} s", change, _pairing(draw), length_ns)
