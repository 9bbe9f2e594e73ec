"""The table of reasons: its numbers are contracts, written down here once more."""

import ast
import re

from support.places import ROOT

from altd.publish.modbus.values import STATUS_BITS
from altd.reasons import Reason, Scope, Signal, StatusGroup
from altd.records import FaultCause
from altd.status.conditions import Condition
from altd.status.health import CameraTrouble

CONTRACT = {
    "spot_missing": 1, "ambiguous": 2, "saturated": 3, "cut_by_edge": 4, "wrong_size": 5, "wrong_shape": 6,
    "camera_silent": 7, "implausible": 8, "exposure_changing": 9, "distorted": 10, "frame_repeated": 11,
    "wrong_camera": 12, "out_of_step": 20, "out_of_range": 21, "unsteady": 22, "warming_up": 23, "stale": 24,
    "check_failed": 25, "geometry_drift": 26, "geometry_unverified": 27, "self_checking": 28, "not_live": 29,
    "geometry_suspect": 0, "geometry_unknown": 0, "compensated": 0, "exposures_lost": 0,
    "playback": 0, "simulated": 0, "rehearsal": 0, "roll_missing": 0, "pitch_diverges": 0,
    "leds_missing": 30, "leds_misfit": 31, "stuck_clear": 13, "slow": 14, "not_confirmed": 15,
    "cameras_swapped": 16, "beam_lost": 32, "stuck_opaque": 0, "switch_unseen": 0, "beam_lost_behind": 0,
    "stable_moved": 0, "stable_targets_disagree": 0, "no_baseline": 0, "baseline_incomplete": 0,
    "beam_angle_unknown": 0, "beam_drift_unknown": 0, "beam_not_closed": 0, "alarm_displacement": 0,
    "alarm_rate": 0,
}  # fmt: skip
"""Codes on the wires, and their numbers on Modbus, as released."""

BITS = {
    2: {"stale"}, 3: {"warming_up", "self_checking"}, 4: {"out_of_range"}, 5: {"out_of_step"},
    6: {"unsteady"},
    7: {"exposures_lost"}, 10: {"camera_silent"}, 11: {"camera_silent"}, 12: {"playback"},
    13: {"simulated"}, 14: {"implausible"}, 15: {
        "frame_repeated", "wrong_camera", "check_failed", "geometry_drift", "geometry_unverified",
        "geometry_suspect", "geometry_unknown", "compensated", "not_live",
        "stuck_clear", "slow", "not_confirmed", "cameras_swapped",
    },
}  # fmt: skip


def test_codes_and_numbers_are_those_that_controllers_know() -> None:
    assert {str(reason): reason.modbus_code for reason in Reason} == CONTRACT


def test_bits_are_those_that_controllers_know() -> None:
    known = {row.bit: {str(reason) for reason in row.reasons} for row in STATUS_BITS}
    spots = {code for code, number in CONTRACT.items() if 0 < number < 20} - set().union(*BITS.values())
    assert known == {0: set(), 1: set(), **BITS, 8: spots, 9: spots}


def test_a_reason_is_its_code_and_knows_whose_it_is() -> None:
    assert Reason("stale") is Reason.STALE
    assert f"{Reason.STALE}" == "stale"
    assert {reason for reason in Reason if reason.is_warning} == {
        "exposures_lost", "playback", "simulated", "rehearsal", "roll_missing", "pitch_diverges",
        "geometry_suspect", "geometry_unknown", "compensated", "stuck_opaque", "switch_unseen",
        "beam_lost_behind", "stable_moved", "stable_targets_disagree", "no_baseline", "baseline_incomplete",
        "beam_angle_unknown", "beam_drift_unknown", "beam_not_closed", "alarm_displacement", "alarm_rate",
    }  # fmt: skip
    assert {reason for reason in Reason if reason.scope is Scope.UNIT} == {
        "out_of_step", "out_of_range", "unsteady", "warming_up", "stale", "check_failed",
        "geometry_drift", "geometry_unverified", "self_checking", "not_live",
        "leds_missing", "leds_misfit", "beam_lost",
    }  # fmt: skip


def test_every_group_has_a_reason_and_every_reason_says_what_and_what_to_do() -> None:
    assert {reason.group for reason in Reason} == set(StatusGroup)
    assert all(reason.brief and reason.remedy and reason.meaning for reason in Reason)
    assert all(reason.brief.isascii() and reason.remedy.isascii() for reason in Reason)  # any terminal


def test_no_remedy_sends_a_technician_back_to_the_screen_that_shows_it() -> None:
    remedies = [kind.remedy for table in (Reason, Condition, FaultCause) for kind in table]
    remedies += [trouble.value for trouble in CameraTrouble]
    screens = re.compile(r"`(altd )?(status|watch)\b|\b(page|below|above|component)\b|(^|[,;:] )see |\?")
    assert len(remedies) > 90
    assert [remedy for remedy in remedies if screens.search(remedy)] == []


NOT_WELL_BY_ITSELF = {
    "stuck_clear", "slow", "not_confirmed", "cameras_swapped", "stuck_opaque",
    "camera_silent", "frame_repeated", "wrong_camera", "implausible", "out_of_step", "stale", "check_failed",
    "geometry_drift", "geometry_unverified",
}  # fmt: skip
"""Reasons that no beam and no light can cause in a unit that works."""


def test_every_reason_has_a_signal_and_none_is_good() -> None:
    assert all(reason.signal is not Signal.GOOD for reason in Reason)
    assert {reason for reason in Reason if reason.signal is Signal.FAILURE} == NOT_WELL_BY_ITSELF
    assert {reason for reason in Reason if reason.signal is Signal.CHECK_FUNCTION} == {
        "exposure_changing", "warming_up", "playback", "simulated", "self_checking",
        "not_live", "rehearsal", "baseline_incomplete", "beam_not_closed",
    }  # fmt: skip


def test_maintenance_is_asked_for_only_where_the_numbers_may_be_used() -> None:
    # OPC 10000-100: "although the output signal is valid"
    assert {reason for reason in Reason if reason.signal is Signal.MAINTENANCE_REQUIRED} == {
        "exposures_lost", "roll_missing", "pitch_diverges",
        "geometry_suspect", "geometry_unknown", "compensated", "switch_unseen", "no_baseline",
        "beam_angle_unknown", "beam_drift_unknown",
    }  # fmt: skip
    assert all(reason.is_warning for reason in Reason if reason.signal is Signal.MAINTENANCE_REQUIRED)


def test_signals_are_ordered_from_failure_to_good() -> None:
    assert sorted(Signal, key=lambda signal: signal.severity) == [
        "good", "maintenance_required", "out_of_specification", "check_function", "failure",
    ]  # fmt: skip
    assert Signal.GOOD.severity == 0


def test_signals_have_the_numbers_of_opc_10000_100() -> None:
    assert {str(signal): signal.number for signal in Signal} == {
        "good": 0, "failure": 1, "check_function": 2, "out_of_specification": 3, "maintenance_required": 4,
    }  # fmt: skip


WORDED = {"brief", "complaint", "detail", "meaning", "means", "message", "remedy", "sentence"}
"""Attributes that are sentences for people."""
LOOKS_INTO = {
    "startswith",
    "endswith",
    "removeprefix",
    "removesuffix",
    "partition",
    "rpartition",
    "split",
    "find",
}
SHORTENED = [
    ("altd/acquisition/frame_sets.py", "component.message.removesuffix('; trying again')"),
    ("altd/publish/serial/words.py", "fault.detail.removeprefix(means)"),
]
"""Sentences that lose what the text beside them says; nothing is decided by them."""


def _is_worded(node: ast.expr) -> bool:
    return isinstance(node, ast.Attribute) and node.attr.strip("_") in WORDED


def _looks_into_words(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=attr)):
            return attr in LOOKS_INTO and _is_worded(value)
        case ast.Compare(left=left, comparators=[right]):
            given = left.value if isinstance(left, ast.Constant) else getattr(right, "value", None)
            return isinstance(given, str) and given != "" and (_is_worded(left) or _is_worded(right))
    return False


def test_nothing_is_decided_by_the_words_of_a_sentence() -> None:
    found = [
        (str(path.relative_to(ROOT)), ast.unparse(node))
        for path in sorted((ROOT / "altd").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if _looks_into_words(node)
    ]
    assert found == SHORTENED
