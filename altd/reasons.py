"""Why a measurement is invalid, or what a valid one warns of: the one table of reasons.

Every interface and every page uses this table's text about a reason: its code, its meaning, its remedy, its
number and bit on Modbus, the resulting state of the unit. Codes, numbers and bits are contracts: new ones may
be added, old ones never change.
"""

from __future__ import annotations

from enum import StrEnum


class Scope(StrEnum):
    """Subject of a reason, and whether a measurement with it may be valid."""

    TARGET = "target"
    """One target; published with its name in front, such as ``front_spot_missing``."""
    UNIT = "unit"
    WARNING = "warning"
    """The numbers may be used. Published with a target's name in front if it is about one target of a row."""


class StatusGroup(StrEnum):
    """Bits of Modbus' status word that reasons set; a target's reasons have one bit per target."""

    SPOT_BAD = "spot bad"
    CAMERA_SILENT = "camera silent"
    IMPLAUSIBLE = "implausible"
    NOT_TRUSTED = "not trusted"
    STALE = "stale"
    WARMING_UP = "warming up"
    OUT_OF_RANGE = "out of range"
    OUT_OF_STEP = "out of step"
    UNSTEADY = "unsteady"
    EXPOSURES_LOST = "exposures lost"
    PLAYBACK = "playback"
    SIMULATED = "simulated"
    NO_BIT = "no bit"
    """All sixteen bits are in use: newer reasons are reported by their code only."""


class Signal(StrEnum):
    """The state of the whole unit in the terms of NAMUR NE 107: a code and its number.

    The numbers are those of OPC 10000-100, table 22 (``DeviceHealthEnumeration``). Of several signals the
    worst is shown. Their order is that of NE 107 (edition 2006) and OPC: failure, check function, out of
    specification, maintenance required.
    """

    GOOD = "good", 0
    FAILURE = "failure", 1
    """The unit or a part of it does not work."""
    CHECK_FUNCTION = "check_function", 2
    """The unit temporarily gives no value of the beam: it starts, is set or checked, plays or simulates."""
    OUT_OF_SPECIFICATION = "out_of_specification", 3
    """The unit works, but its environment or the beam is outside the specified conditions."""
    MAINTENANCE_REQUIRED = "maintenance_required", 4
    """The values are correct, but the unit may soon fail to deliver them."""

    number: int

    def __new__(cls, code: str, number: int) -> Signal:
        """Create a member that is equal to its code."""
        signal = str.__new__(cls, code)
        signal._value_ = code
        signal.number = number
        return signal

    @property
    def severity(self) -> int:
        """Severity of the signal: 0 for good, larger for worse ones."""
        return (len(Signal) - self.number) % len(Signal)


_TARGET, _UNIT, _WARNING = Scope
_, _FAILURE, _CHECK_FUNCTION, _OUT_OF_SPECIFICATION, _MAINTENANCE_REQUIRED = Signal
_CLEAN_AND_LOOK = "clean the window, look for reflections and for objects in the beam"
_NOT_LIVE = "do not steer by it"


class Reason(StrEnum):
    """A row of the table: code, scope, Modbus' number (0: none) and group, signal, brief, remedy, meaning.

    ``brief`` describes the fault in a few words. ``remedy`` is the technician's action if no more is known
    than the reason. ``meaning`` is the exact condition for the reason, in Markdown.
    """

    SPOT_MISSING = (
        "spot_missing", _TARGET, 1, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "no laser spot",
        "switch the laser on and check that its beam enters the window",
        "nothing is brighter than the background, or the spot is too dim to be located",
    )  # fmt: skip
    AMBIGUOUS = (
        "ambiguous", _TARGET, 2, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "more than one spot",
        "look for reflections and other lasers or lamps in the window",
        "a second spot has at least 30 % of the light of the first",
    )  # fmt: skip
    SATURATED = (
        "saturated", _TARGET, 3, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "the spot is overexposed",
        "shorten the exposure or take power off the laser",
        "more than half of the spot's bright pixels share the largest value, or the background is full",
    )  # fmt: skip
    CUT_BY_EDGE = (
        "cut_by_edge", _TARGET, 4, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "the spot is cut by the edge of the image",
        "bring the beam nearer to the middle",
        "too much of the spot is beyond the edge of the image",
    )  # fmt: skip
    WRONG_SIZE = (
        "wrong_size", _TARGET, 5, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "the spot has a wrong size",
        "clean the window and check the focus of the laser",
        "the diameter is not that of a spot which the unit measures: 8 px to 17 mm",
    )  # fmt: skip
    WRONG_SHAPE = (
        "wrong_shape", _TARGET, 6, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "the spot has a wrong shape",
        _CLEAN_AND_LOOK,
        "the elongation or the outline is not that of a laser spot, or its profile is not that of the "
        "calibrated beam: a top hat, a ring",
    )  # fmt: skip
    DISTORTED = (
        "distorted", _TARGET, 10, StatusGroup.SPOT_BAD, _OUT_OF_SPECIFICATION,
        "the spot is distorted",
        "clean the window, look for reflections and other light",
        "the light is not that of one spot as calibrated: a reflection, dirt, the edge of a lamp's light or "
        "of a shadow, a torn or enlarged picture, strongly turbulent air",
    )  # fmt: skip
    CAMERA_SILENT = (
        "camera_silent", _TARGET, 7, StatusGroup.CAMERA_SILENT, _FAILURE,
        "the camera delivers no frames",
        "check the camera's cable and supply",
        "the camera delivers no frames",
    )  # fmt: skip
    EXPOSURE_CHANGING = (
        "exposure_changing", _TARGET, 9, StatusGroup.SPOT_BAD, _CHECK_FUNCTION,
        "the exposure is being set",
        "wait a second; if this continues, look for light that flickers",
        "the camera's exposure is being changed; lasts less than a second",
    )  # fmt: skip
    FRAME_REPEATED = (
        "frame_repeated", _TARGET, 11, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the camera repeats one picture",
        "unplug the camera and plug it in again",
        "the camera repeats a picture or a part of it: it is frozen",
    )  # fmt: skip
    WRONG_CAMERA = (
        "wrong_camera", _TARGET, 12, StatusGroup.NOT_TRUSTED, _FAILURE,
        "another camera than the calibrated one",
        "check the cameras' cables and the calibration file",
        "the camera, or its view, is not the calibrated one",
    )  # fmt: skip
    IMPLAUSIBLE = (
        "implausible", _TARGET, 8, StatusGroup.IMPLAUSIBLE, _FAILURE,
        "two maps of the target contradict each other",
        "load or make the calibration again",
        "the target's two maps differ at the spot by more than the calibration's limit",
    )  # fmt: skip

    STUCK_CLEAR = (
        "stuck_clear", _TARGET, 13, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the glass does not turn opaque",
        "check the switch and the supply of this glass",
        "the beam passes the glass while it is to be opaque",
    )  # fmt: skip
    SLOW = (
        "slow", _TARGET, 14, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the glass is not settled when it is exposed",
        "make `chain.settle_s` longer; cold glass is slow",
        "the light of the spot still grows in the exposures of its glass, or fades in those of the next",
    )  # fmt: skip
    NOT_CONFIRMED = (
        "not_confirmed", _TARGET, 15, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the camera does not confirm the switching of the glass",
        "look for covers, lamps and reflections before the camera",
        "the glass switches and its camera sees no spot, or sees one without the beam",
    )  # fmt: skip
    CAMERAS_SWAPPED = (
        "cameras_swapped", _TARGET, 16, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the camera looks at another target",
        "exchange the cables of the two cameras",
        "two cameras show the spot in each other's visit, and not in their own",
    )  # fmt: skip

    OUT_OF_STEP = (
        "out_of_step", _UNIT, 20, StatusGroup.OUT_OF_STEP, _FAILURE,
        "the cameras are not synchronised",
        "check the trigger of the cameras",
        "the cameras' frames are not of the same instants, by their times or the spots' motion",
    )  # fmt: skip
    OUT_OF_RANGE = (
        "out_of_range", _UNIT, 21, StatusGroup.OUT_OF_RANGE, _OUT_OF_SPECIFICATION,
        "outside the calibrated area",
        "bring the beam nearer to the middle",
        "a spot is half a pitch outside the calibration grid, or where its map's sigma reaches 0.05 mm; or "
        "the beam is steeper than yaw ±110, pitch ±250 mm/m",
    )  # fmt: skip
    UNSTEADY = (
        "unsteady", _UNIT, 22, StatusGroup.UNSTEADY, _OUT_OF_SPECIFICATION,
        "the spot moves too much",
        "wait until the machine is at rest, look for vibration",
        "the beam jumped during averaging, or scatters by more than `max_sigma_mm`",
    )  # fmt: skip
    WARMING_UP = (
        "warming_up", _UNIT, 23, StatusGroup.WARMING_UP, _CHECK_FUNCTION,
        "too few exposures so far",
        "wait some seconds",
        "fewer exposures than half a window or, at uneven times, than 18",
    )  # fmt: skip
    STALE = (
        "stale", _UNIT, 24, StatusGroup.STALE, _FAILURE,
        "measurements have stopped",
        "restart the unit; if this continues, run `altd doctor`",
        "no new exposure, or no measurement, for longer than `stale_after_s`",
    )  # fmt: skip
    CHECK_FAILED = (
        "check_failed", _UNIT, 25, StatusGroup.NOT_TRUSTED, _FAILURE,
        "impossible values",
        "restart the unit, check its config and calibration",
        "the numbers are not finite, not ordered or outside the measuring range",
    )  # fmt: skip
    LEDS_MISSING = (
        "leds_missing", _UNIT, 30, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "too few LEDs of the plate are seen",
        "check the LEDs' supply, and whether the camera sees them",
        "fewer than two lights in the picture can be LEDs of the plate",
    )  # fmt: skip
    LEDS_MISFIT = (
        "leds_misfit", _UNIT, 31, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "the lights do not fit the plate's layout",
        "look for reflections, lamps and other plates in the picture, and check the plate's layout",
        "the lights are not where a rigid plate has its LEDs, fit the layout in two ways, or are too few "
        "to tell LEDs from other lights",
    )  # fmt: skip
    BEAM_LOST = (
        "beam_lost", _UNIT, 32, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "no target of the row sees the beam",
        "check the laser, and whether an object blocks its beam",
        "all cameras of a row of targets deliver frames, but none has a spot during its visit",
    )  # fmt: skip
    GEOMETRY_DRIFT = (
        "geometry_drift", _UNIT, 26, StatusGroup.NOT_TRUSTED, _FAILURE,
        "cameras or targets are not where they were calibrated",
        "check cameras and targets for a blow or loose screws; then calibrate the unit again",
        "the self-check found a drift above `bad_mm` or `bad_deg`",
    )  # fmt: skip
    GEOMETRY_UNVERIFIED = (
        "geometry_unverified", _UNIT, 27, StatusGroup.NOT_TRUSTED, _FAILURE,
        "the self-check could not determine whether cameras and targets are in place",
        "check the frame LEDs and their wiring, clean the windows, move the beam",
        "as `geometry_unknown`, while `when_unknown` is `invalid`",
    )  # fmt: skip
    SELF_CHECKING = (
        "self_checking", _UNIT, 28, StatusGroup.WARMING_UP, _CHECK_FUNCTION,
        "the unit checks itself before its first measurement",
        "wait some seconds",
        "the first self-check since the start has not ended",
    )  # fmt: skip

    NOT_LIVE = (
        "not_live", _UNIT, 29, StatusGroup.NOT_TRUSTED, _CHECK_FUNCTION,
        "frames or calibration are not this unit's own",
        "set the unit's cameras and its calibration in the config; to rehearse, start `altd run --rehearsal`",
        "frames or calibration are played or simulated, and the daemon runs without `--rehearsal`",
    )  # fmt: skip

    EXPOSURES_LOST = (
        "exposures_lost", _WARNING, 0, StatusGroup.EXPOSURES_LOST, _MAINTENANCE_REQUIRED,
        "exposures were lost",
        "if this continues, check the cameras' cables",
        "some exposures of the window were not usable",
    )  # fmt: skip
    PLAYBACK = (
        "playback", _WARNING, 0, StatusGroup.PLAYBACK, _CHECK_FUNCTION,
        "PLAYBACK of a recording",
        _NOT_LIVE,
        "the frames are from a recording",
    )  # fmt: skip
    SIMULATED = (
        "simulated", _WARNING, 0, StatusGroup.SIMULATED, _CHECK_FUNCTION,
        "SIMULATED, not live",
        _NOT_LIVE,
        "frames or calibration are from a simulator",
    )  # fmt: skip
    REHEARSAL = (
        "rehearsal", _WARNING, 0, StatusGroup.NO_BIT, _CHECK_FUNCTION,
        "rehearsal mode is on",
        _NOT_LIVE,
        "the daemon runs with `--rehearsal`: played and simulated frames give valid values",
    )  # fmt: skip
    ROLL_MISSING = (
        "roll_missing", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "no roll from the inclinometer",
        "check the inclinometer's cable, supply and table in the config",
        "the fitted inclinometer gives no usable value; the beam's numbers are right",
    )  # fmt: skip
    PITCH_DIVERGES = (
        "pitch_diverges", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "the beam's pitch drifts against gravity's",
        "check whether the laser has moved or warm air crosses the beam",
        "the beam's inclination against gravity differs by more than `divergence_sigmas` uncertainties from "
        "the surveyed or an earlier one: refraction, or the laser, the inclinometer or a camera has moved",
    )  # fmt: skip

    STUCK_OPAQUE = (
        "stuck_opaque", _WARNING, 0, StatusGroup.NO_BIT, _FAILURE,
        "the glass does not turn clear",
        "check the switch and the supply of this glass: all targets behind it are dark",
        "the glass shows the spot while others are to show it; its own place is right",
    )  # fmt: skip
    SWITCH_UNSEEN = (
        "switch_unseen", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "no frame shows the target while it is clear",
        "record frames of all cameras in each exposure",
        "only frames of the opaque target's camera are known: a stuck glass may stay unseen",
    )  # fmt: skip
    BEAM_LOST_BEHIND = (
        "beam_lost_behind", _WARNING, 0, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "the beam does not reach the targets behind it",
        "look for objects in the beam behind this target",
        "the target is clear when it is to be, and all targets behind it are dark",
    )  # fmt: skip
    STABLE_MOVED = (
        "stable_moved", _WARNING, 0, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "a stable target has moved",
        "inspect its place; name another target as stable and make a new baseline",
        "four stable targets or more, and the others agree without it; the beam is known by these",
    )  # fmt: skip
    STABLE_DISAGREE = (
        "stable_targets_disagree", _WARNING, 0, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "the stable targets do not fit one beam",
        "inspect the places of the stable targets: one has moved",
        "three stable targets or more, and it is not known which has moved: no displacement is known",
    )  # fmt: skip
    NO_BASELINE = (
        "no_baseline", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "the baseline lacks the target",
        "make a new baseline while all targets see the spot",
        "the target was measured in less than half of the baseline's rounds: it has no displacement",
    )  # fmt: skip
    BASELINE_INCOMPLETE = (
        "baseline_incomplete", _WARNING, 0, StatusGroup.NO_BIT, _CHECK_FUNCTION,
        "the baseline is being made",
        "wait for `chain.baseline_rounds` rounds in which all stable targets see the spot",
        "places are known, displacements are not yet",
    )  # fmt: skip
    BEAM_ANGLE_UNKNOWN = (
        "beam_angle_unknown", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "only one stable target shows the beam's drift",
        "name two stable targets, or bring the other back",
        "the beam's angle is not known; sigma includes the movement common to all targets",
    )  # fmt: skip
    BEAM_DRIFT_UNKNOWN = (
        "beam_drift_unknown", _WARNING, 0, StatusGroup.NO_BIT, _MAINTENANCE_REQUIRED,
        "the beam's drift is unknown",
        "name two stable targets, or bring them back",
        "neither offset nor angle of the beam is known; sigma includes the movement common to all targets",
    )  # fmt: skip
    BEAM_NOT_CLOSED = (
        "beam_not_closed", _WARNING, 0, StatusGroup.NO_BIT, _CHECK_FUNCTION,
        "no later visit shows how the beam moved on",
        "record one more round",
        "the last round of a recording: a beam that jumped within it is not seen",
    )  # fmt: skip
    ALARM_DISPLACEMENT = (
        "alarm_displacement", _WARNING, 0, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "the place has moved beyond its limit",
        "follow the plan for movement of the rock",
        "the displacement is at least `chain.alarm_mm`, with a significance of 4 or more",
    )  # fmt: skip
    ALARM_RATE = (
        "alarm_rate", _WARNING, 0, StatusGroup.NO_BIT, _OUT_OF_SPECIFICATION,
        "the place moves faster than its limit",
        "follow the plan for movement of the rock",
        "the speed of the last day is at least `chain.alarm_mm_per_day`, with a significance of 4 or more",
    )  # fmt: skip

    GEOMETRY_SUSPECT = (
        "geometry_suspect", _WARNING, 0, StatusGroup.NOT_TRUSTED, _MAINTENANCE_REQUIRED,
        "cameras or targets have moved a little since the calibration",
        "look for loose screws at cameras and targets, and plan a calibration",
        "the self-check found a drift above `suspect_mm` or `suspect_deg`, or a bad one while `when_bad` is "
        "`warning`",
    )  # fmt: skip
    GEOMETRY_UNKNOWN = (
        "geometry_unknown", _WARNING, 0, StatusGroup.NOT_TRUSTED, _MAINTENANCE_REQUIRED,
        "the self-check could not determine whether cameras and targets are in place",
        "check the frame LEDs and their wiring, clean the windows, move the beam",
        "the last self-check has no verdict on the unit or a part of it, or the one after a shock has not "
        "ended",
    )  # fmt: skip
    COMPENSATED = (
        "compensated", _WARNING, 0, StatusGroup.NOT_TRUSTED, _MAINTENANCE_REQUIRED,
        "a drift of cameras or targets is taken out of the measurement",
        "plan a calibration",
        "spot positions are corrected by the last self-check; sigma includes the uncertainty of that",
    )  # fmt: skip

    scope: Scope
    modbus_code: int
    group: StatusGroup
    signal: Signal
    brief: str
    remedy: str
    meaning: str

    def __new__(  # noqa: PLR0913  a row of the table
        cls,
        code: str,
        scope: Scope,
        modbus_code: int,
        group: StatusGroup,
        signal: Signal,
        brief: str,
        remedy: str,
        meaning: str,
    ) -> Reason:
        """Create a member that is equal to its code."""
        reason = str.__new__(cls, code)
        reason._value_ = code
        reason.scope, reason.modbus_code, reason.group = scope, modbus_code, group
        reason.signal, reason.brief, reason.remedy, reason.meaning = signal, brief, remedy, meaning
        return reason

    @property
    def is_warning(self) -> bool:
        """Whether a measurement with this reason may still be valid."""
        return self.scope is Scope.WARNING


NOT_FROM_CAMERAS = frozenset({Reason.PLAYBACK, Reason.SIMULATED})
"""Reasons of a measurement that does not come from the unit's cameras."""
