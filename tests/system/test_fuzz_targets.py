"""Every fuzz target, for a few inputs that are always the same; `make fuzz` tries many."""

from typing import Any

import pytest
from fuzz.limits import bounded
from fuzz.target import load, names
from hypothesis import HealthCheck, given, settings

EXAMPLES = 50


@pytest.mark.parametrize("name", names())
def test_no_input_is_a_defect(name: str) -> None:
    target = load(name)

    @settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
    @given(target.EXAMPLES)
    def run(example: Any) -> None:
        with bounded():
            target.check(example)

    run()


@pytest.mark.parametrize("name", names())
def test_a_target_carries_the_name_of_its_file(name: str) -> None:
    assert name == load(name).NAME
