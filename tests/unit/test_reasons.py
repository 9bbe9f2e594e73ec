"""The table of reasons: its numbers are contracts, written down here once more."""

from __future__ import annotations

from altd.publish.modbus.status import STATUS_BITS
from altd.reasons import Reason, Scope, StatusGroup

CONTRACT = {
    "spot_missing": 1, "ambiguous": 2, "saturated": 3, "cut_by_edge": 4, "wrong_size": 5, "wrong_shape": 6,
    "camera_silent": 7, "implausible": 8, "exposure_changing": 9, "distorted": 10, "frame_repeated": 11,
    "wrong_camera": 12, "out_of_step": 20, "out_of_range": 21, "unsteady": 22, "warming_up": 23, "stale": 24,
    "check_failed": 25, "exposures_lost": 0, "playback": 0, "simulated": 0,
}  # fmt: skip
"""Codes on the wires, and their numbers on Modbus, as released."""

BITS = {
    2: {"stale"}, 3: {"warming_up"}, 4: {"out_of_range"}, 5: {"out_of_step"}, 6: {"unsteady"},
    7: {"exposures_lost"}, 10: {"camera_silent"}, 11: {"camera_silent"}, 12: {"playback"},
    13: {"simulated"}, 14: {"implausible"}, 15: {"frame_repeated", "wrong_camera", "check_failed"},
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
    assert {reason for reason in Reason if reason.is_warning} == {"exposures_lost", "playback", "simulated"}
    assert {reason for reason in Reason if reason.scope is Scope.UNIT} == {
        "out_of_step", "out_of_range", "unsteady", "warming_up", "stale", "check_failed",
    }  # fmt: skip


def test_every_group_has_a_reason_and_every_reason_says_what_and_what_to_do() -> None:
    assert {reason.group for reason in Reason} == set(StatusGroup)
    assert all(reason.brief and reason.remedy and reason.meaning for reason in Reason)
    assert all(reason.brief.isascii() and reason.remedy.isascii() for reason in Reason)  # any terminal
