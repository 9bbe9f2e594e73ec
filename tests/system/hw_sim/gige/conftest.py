"""A unit that is served to the tests of a module, its beam aslant and at rest."""

from collections.abc import Iterator

import pytest
from support.gige_unit import Served, served

SEED = 5
POSE = ("8", "-6", "2", "-1.5")


@pytest.fixture(scope="module")
def unit_at_rest() -> Iterator[Served]:
    with served("--seed", str(SEED), "--pose", *POSE, "--listen") as cameras:
        yield cameras
