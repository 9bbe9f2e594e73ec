"""Ways with wrong times and numbers of frames, and with a process that was held."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from benchmarks.campaign.way import CAMERAS, MS, PERIOD_NS, START_NS, Draw, Registry, S, names_of, summary_of

TRANSFER_NS = 5 * MS


@dataclass(frozen=True, slots=True)
class Delivery:
    """A frame in transfer: its exposure time ``true_ns``, its number and stamp, and its arrival."""

    camera: str
    true_ns: int
    sequence: int
    t_ns: int
    arrives_ns: int


def undisturbed(exposures: range) -> list[Delivery]:
    """Frames of both cameras that arrive as they should."""
    return [
        Delivery(camera, t_ns, 100_000 + k, t_ns, t_ns + TRANSFER_NS)
        for k in exposures
        for camera in CAMERAS
        for t_ns in (START_NS + k * PERIOD_NS,)
    ]


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


WAYS = Registry("times")
_Make = Callable[[Draw], Mistimed]

_STEADY_DELAY = (
    "one camera that lags steadily by up to a second and stamps on arrival differs from a yaw only by the "
    "machine's vibration: speed × delay, up to 4 mm at 4 mm/s"
)


def _row(name: str, summary: str, make: _Make, own_clock: bool | None = None, invisible: str = "") -> None:
    """Register a way; ``own_clock``: whether a camera's clock stamps, None: in half of the cases.

    A V4L2 camera is stamped by the kernel of the host, so its clock has no faults of its own.
    """

    def of_camera(draw: Draw) -> Mistimed:
        mistimed = make(draw)
        is_own = bool(draw.rng.random() < 0.5) if own_clock is None else own_clock
        return replace(mistimed, own_clock=is_own)

    WAYS.row(name, summary, of_camera, invisible=invisible)


def _enter(own_clock: bool | None = None, invisible: str = "") -> Callable[[_Make], _Make]:
    """Return a decorator that registers a function under its own name and docstring."""

    def enter(make: _Make) -> _Make:
        _row(make.__name__, summary_of(make), make, own_clock, invisible)
        return make

    return enter


def _each(
    change: Callable[[Delivery], Delivery], cameras: frozenset[str], length_ns: int | None = None
) -> Change:
    """Change the frames of some cameras from the onset on, for this duration."""

    def changed(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        def of(one: Delivery) -> Delivery:
            since_ns = one.true_ns - onset_ns
            meant = one.camera in cameras and since_ns >= 0 and (length_ns is None or since_ns < length_ns)
            return change(one) if meant else one

        return [of(one) for one in deliveries]

    return changed


def _mistimed(draw: Draw, note: str, change: Change, end_ns: int | None = None, held_ns: int = 0) -> Mistimed:
    """Disturb the times of frames that are paired by time in three of four cases."""
    return Mistimed(note, change, "time" if draw.rng.random() < 0.75 else "sequence", end_ns, held_ns)


def _far_ns(draw: Draw) -> int:
    return round(draw.log(0.02, 7200.0) * S)


@_enter()
def clean_times(draw: Draw) -> Mistimed:
    """No disturbance."""
    return _mistimed(draw, "nothing disturbed", lambda deliveries, onset_ns: deliveries, 0)


def _one_stamp(draw: Draw, sign: int) -> Mistimed:
    far_ns, cameras = _far_ns(draw), draw.targets()
    change = _each(lambda one: replace(one, t_ns=one.t_ns + sign * far_ns), cameras, PERIOD_NS)
    return _mistimed(draw, f"by {far_ns / S:.2f} s, {names_of(cameras)}", change, PERIOD_NS)


_row(
    "stamp_ahead",
    "One frame, of one camera or both, has a later time stamp.",
    lambda draw: _one_stamp(draw, 1),
)
_row("stamp_back", "One frame has an earlier time stamp.", lambda draw: _one_stamp(draw, -1))


@_enter(own_clock=True)
def clock_steps(draw: Draw) -> Mistimed:
    """The clock of one camera or both jumps."""
    far_ns, cameras = draw.sign() * _far_ns(draw), draw.targets()
    change = _each(lambda one: replace(one, t_ns=one.t_ns + far_ns), cameras)
    return _mistimed(draw, f"by {far_ns / S:+.2f} s, {names_of(cameras)}", change)


def _stuck(draw: Draw, as_first: Callable[[Delivery, Delivery], Delivery]) -> Mistimed:
    """Let frames repeat the number or the stamp of the first one for a while."""
    length_ns, cameras = draw.whole(2, 40) * PERIOD_NS, draw.targets()

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        first = next(one for one in deliveries if one.true_ns >= onset_ns)
        return _each(lambda one: as_first(one, first), cameras, length_ns)(deliveries, onset_ns)

    return _mistimed(draw, f"for {length_ns / S:.2f} s", change, length_ns)


_row(
    "stamps_stuck",
    "The time stamps of a camera repeat for a while.",
    lambda draw: _stuck(draw, lambda one, first: replace(one, t_ns=first.t_ns)),
)


@_enter()
def stamps_zero(draw: Draw) -> Mistimed:
    """The time stamps of a camera are 0."""
    length_ns, cameras = draw.whole(1, 20) * PERIOD_NS, draw.targets()
    change = _each(lambda one: replace(one, t_ns=0), cameras, length_ns)
    return _mistimed(draw, f"for {length_ns / S:.2f} s", change, length_ns)


@_enter()
def stamps_jitter(draw: Draw) -> Mistimed:
    """The time stamps of a camera jitter."""
    sigma_ns, cameras, rng = draw.log(1, 60) * MS, draw.targets(), draw.rng
    change = _each(lambda one: replace(one, t_ns=one.t_ns + round(rng.normal(0, sigma_ns))), cameras)
    return _mistimed(draw, f"by {sigma_ns / MS:.0f} ms", change)


def _rated(draw: Draw, rate: float, words: str) -> Mistimed:
    cameras = draw.targets()

    def change(deliveries: list[Delivery], onset_ns: int) -> list[Delivery]:
        def faster(one: Delivery) -> Delivery:
            return replace(one, t_ns=one.t_ns + round(rate * (one.true_ns - onset_ns)))

        return _each(faster, cameras)(deliveries, onset_ns)

    return _mistimed(draw, f"{words}, {names_of(cameras)}", change)


@_enter(own_clock=True)
def stamps_doubled(draw: Draw) -> Mistimed:
    """Time stamps in a wrong unit: twice or half the rate."""
    rate = 1.0 if draw.sign() > 0 else -0.5
    return _rated(draw, rate, f"{1 + rate:g} times as fast")


@_enter(own_clock=True)
def clock_drifts(draw: Draw) -> Mistimed:
    """A camera's clock drifts by 0.01 to 20 %."""
    rate = draw.sign() * draw.log(1e-4, 0.2)
    return _rated(draw, rate, f"{rate:+.2%}")


def _renumbered(draw: Draw, by: int, length_ns: int | None) -> Mistimed:
    cameras = draw.targets()
    change = _each(lambda one: replace(one, sequence=max(one.sequence + by, 0)), cameras, length_ns)
    return _mistimed(draw, f"by {by:+d}, {names_of(cameras)}", change, length_ns)


_row(
    "numbers_jump",
    "The frame numbers jump and continue from there.",
    lambda draw: _renumbered(draw, draw.sign() * round(draw.log(1, 5000)), None),
)
_row(
    "number_once",
    "One frame has a wrong number.",
    lambda draw: _renumbered(draw, draw.sign() * round(draw.log(1, 1e9)), PERIOD_NS),
)
_row(
    "numbers_stuck",
    "The frame numbers repeat for a while.",
    lambda draw: _stuck(draw, lambda one, first: replace(one, sequence=first.sequence)),
)


@_enter()
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

    return _mistimed(draw, f"{held_ns / S:.1f} s, {kept} frames kept", change, held_ns, held_ns)


@_enter()
def frames_delayed(draw: Draw) -> Mistimed:
    """Frames of one camera or both arrive late with true time stamps."""
    late_ns, cameras = round(draw.log(0.05, 4.0) * S), draw.targets()
    length_ns = draw.whole(1, 40) * PERIOD_NS
    change = _each(lambda one: replace(one, arrives_ns=one.arrives_ns + late_ns), cameras, length_ns)
    return _mistimed(draw, f"by {late_ns / S:.2f} s for {length_ns / S:.2f} s", change, length_ns + late_ns)


@_enter(own_clock=False, invisible=_STEADY_DELAY)
def delayed_and_stamped_on_arrival(draw: Draw) -> Mistimed:
    """Frames arrive up to a second late and are stamped on arrival."""
    late_ns, cameras = round(draw.log(0.05, 1.0) * S), draw.one()
    change = _each(
        lambda one: replace(one, arrives_ns=one.arrives_ns + late_ns, t_ns=one.t_ns + late_ns), cameras
    )
    return Mistimed(f"by {late_ns / S:.2f} s, {names_of(cameras)}", change, "time")


@_enter()
def bursts(draw: Draw) -> Mistimed:
    """Frames arrive in groups."""
    size, cameras = draw.whole(2, 12), draw.targets()
    step_ns = size * PERIOD_NS
    change = _each(lambda one: replace(one, arrives_ns=-(-one.arrives_ns // step_ns) * step_ns), cameras)
    return _mistimed(draw, f"of {size}", change)


@_enter()
def out_of_order(draw: Draw) -> Mistimed:
    """Neighbouring frames of a camera arrive in exchanged order."""
    cameras = draw.targets()

    def later(one: Delivery) -> Delivery:
        return replace(one, arrives_ns=one.arrives_ns + (3 * PERIOD_NS // 2 if one.sequence % 2 else 0))

    return _mistimed(draw, names_of(cameras), _each(later, cameras))


def _without(is_lost: Callable[[Delivery, int], bool]) -> Change:
    """Omit the frames selected by ``is_lost``, which gets the time of exposure since the onset, ns."""
    return lambda deliveries, onset_ns: [
        one for one in deliveries if not is_lost(one, one.true_ns - onset_ns)
    ]


@_enter()
def frames_lost(draw: Draw) -> Mistimed:
    """Some frames never arrive."""
    share, cameras, rng = draw.uniform(0.02, 0.9), draw.targets(), draw.rng
    change = _without(lambda one, since_ns: since_ns >= 0 and one.camera in cameras and rng.random() < share)
    return _mistimed(draw, f"{share:.0%}, {names_of(cameras)}", change)


@_enter()
def camera_silent(draw: Draw) -> Mistimed:
    """One camera or both deliver nothing for a while."""
    length_ns, cameras = round(draw.log(0.1, 4.0) * S), draw.targets()
    change = _without(lambda one, since_ns: one.camera in cameras and 0 <= since_ns < length_ns)
    return _mistimed(draw, f"for {length_ns / S:.2f} s", change, length_ns)
