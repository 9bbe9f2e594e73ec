"""Which calibration a report says that it is of."""

from __future__ import annotations

from pathlib import Path

import pytest

from altd.calibration.report.write import HEAD_BYTES, checksum_in, meta_line, page_path

CHECKSUM = f"sha256:{'0123456789abcdef' * 4}"
PAGE = f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n{meta_line(CHECKSUM)}\n'


def test_a_page_names_its_calibration() -> None:
    assert checksum_in(PAGE.encode()) == CHECKSUM


@pytest.mark.parametrize(
    "head",
    [
        "",
        "<!DOCTYPE html><title>an older report</title>",
        PAGE.replace("sha256:0", "sha256:g"),
        PAGE.replace('abcdef">', 'abcde">'),
        PAGE.replace('abcdef">', 'abcdef0">'),
        PAGE.replace("altd-calibration", "another"),
        " " * HEAD_BYTES + PAGE,
    ],
)
def test_what_names_none_names_none(head: str) -> None:
    assert checksum_in(head.encode()) is None


def test_a_report_lies_beside_its_calibration_under_the_same_name() -> None:
    assert page_path(Path("/etc/altd/unit-7.json")) == Path("/etc/altd/unit-7.html")
    assert page_path(Path("calibration")) == Path("calibration.html")
