"""Files of a report, and the calibration that a report says that it is of."""

import errno
import os
from pathlib import Path

import pytest

from altd.calibration.report.write import (
    HEAD_BYTES,
    check_report,
    checksum_in,
    meta_line,
    page_path,
    report_names,
    write_together,
)
from altd.errors import BadInputError

NAMES = ("calibration.html", "calibration.pdf", "calibration-budget.json")


@pytest.mark.parametrize("before", [None, b"old"])
def test_when_the_second_cannot_be_named_the_first_is_as_it_was(
    before: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that takes both files and then refuses the second name: nothing real does that on demand."""

    def replace(temporary: Path, place: Path) -> None:
        if place.name == "b":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        temporary.rename(place)

    monkeypatch.setattr(Path, "replace", replace)
    if before is not None:
        (tmp_path / "a").write_bytes(before)
    with pytest.raises(BadInputError, match="Input/output error"):
        write_together(tmp_path, {"a": b"new", "b": b"new"})
    found = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert found == ({} if before is None else {"a": before})


def test_looking_leaves_nothing_behind(tmp_path: Path) -> None:
    check_report(tmp_path / "new", NAMES)
    assert list(tmp_path.iterdir()) == []
    check_report(tmp_path, NAMES)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_is_made_when_it_is_written(tmp_path: Path) -> None:
    write_together(tmp_path / "new", {"a": b"1"})
    assert (tmp_path / "new" / "a").read_bytes() == b"1"


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("none/report", "No such file"),
        ("file", "is not a folder"),
        ("full", "full/calibration.pdf: is a folder"),
        (
            "linked",
            "linked/calibration.html: is a symbolic link: name the file that it points to, /etc/passwd",
        ),
    ],
)
def test_a_folder_that_cannot_be_used_is_named(place: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "full" / "calibration.pdf").mkdir(parents=True)
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "calibration.html").symlink_to("/etc/passwd")
    with pytest.raises(BadInputError, match=why) as caught:
        check_report(tmp_path / place, NAMES)
    assert place in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_report_has_the_name_of_its_calibration_and_never_takes_its_place() -> None:
    assert report_names(Path("unit-7.json")) == ("unit-7.html", "unit-7.pdf", "unit-7-budget.json")
    for name in ("cal.html", "some/cal.pdf"):
        with pytest.raises(BadInputError, match="is reserved for its report"):
            report_names(Path(name))


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
