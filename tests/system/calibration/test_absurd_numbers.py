"""Every number of a calibration file is finite and of a size that a unit can have; no other is taken in."""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from altd.measuring.calibration import Calibration

Key = tuple[str | int, ...]


def numbers(document: Any, key: Key = ()) -> Iterator[Key]:
    """The place of every number, of a list of numbers that of the last."""
    if isinstance(document, dict):
        for name, value in document.items():
            yield from numbers(value, (*key, name))
    elif isinstance(document, list) and document:
        yield from numbers(document[-1], (*key, len(document) - 1))
    elif isinstance(document, int | float):
        yield key


def complaint(path: Path, document: dict[str, Any], key: Key, value: float) -> str:
    spoilt = copy.deepcopy(document)
    place: Any = spoilt
    for part in key[:-1]:
        place = place[part]
    place[key[-1]] = value
    spoilt["checksum"] = checksum_of(spoilt)
    path.write_text(json.dumps(spoilt))
    with pytest.raises(BadInputError) as caught:
        load_calibration(path)
    return str(caught.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e200, 1e200])
def test_a_number_that_is_none_or_absurd_is_refused_with_its_key_and_value(
    calibration_of_unit_3: Calibration, value: float, tmp_path: Path
) -> None:
    path = tmp_path / "cal.json"
    save_calibration(calibration_of_unit_3, path)
    document = json.loads(path.read_text())
    del document["checksum"]
    keys = list(numbers(document))
    assert len(keys) > 40
    for key in keys:
        said = complaint(path, document, key, value)
        assert said.startswith(f"{path}: {'.'.join(map(str, key))}: "), said
        assert said.endswith(f", not {value}"), said
        assert "\n" not in said
