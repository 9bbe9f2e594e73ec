"""Numbers of things in sentences."""

from __future__ import annotations

import pytest

from altd.records import counted


@pytest.mark.parametrize(
    ("number", "said"), [(0, "0 exposures"), (1, "1 exposure"), (2, "2 exposures"), (21, "21 exposures")]
)
def test_only_one_is_singular(number: int, said: str) -> None:
    assert counted(number, "exposure") == said
