"""A thread's longest use of the interpreter, and the objects that a collection visits."""

from __future__ import annotations

import gc
import sys

import pytest

from altd.runtime.threads import real_time_interpreter


def test_within_threads_give_way_fifty_times_sooner_and_after_as_they_did() -> None:
    interval_s = sys.getswitchinterval()
    with real_time_interpreter():
        assert sys.getswitchinterval() == pytest.approx(interval_s / 50)
    assert sys.getswitchinterval() == interval_s


def test_a_collection_goes_through_what_is_new_and_all_is_as_it_was_after() -> None:
    frozen = gc.get_freeze_count()
    gc.disable()  # as `altd run` starts
    with real_time_interpreter():
        assert gc.isenabled()
        assert gc.get_freeze_count() > 10_000  # modules alone
        assert len(gc.get_objects()) < 1_000
        cycle: list[object] = []
        cycle.append(cycle)
        del cycle
        assert gc.collect() >= 1
    assert gc.get_freeze_count() == frozen
    assert len(gc.get_objects()) > 10_000


def test_a_failure_within_leaves_the_interpreter_as_it_was() -> None:
    interval_s = sys.getswitchinterval()
    with pytest.raises(ZeroDivisionError), real_time_interpreter():
        _ = 1 / 0
    assert (sys.getswitchinterval(), gc.get_freeze_count()) == (interval_s, 0)
