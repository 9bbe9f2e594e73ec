"""The defects of ``python -m tools.defects`` have their places in the code as it is now."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.defects.catalogue import DEFECTS, Defect

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_defect_has_one_place_and_changes_it(defect: Defect) -> None:
    assert (ROOT / defect.file).read_text(encoding="utf-8").count(defect.old) == 1
    assert defect.new != defect.old
