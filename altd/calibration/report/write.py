"""Both files of a report, or none."""

from __future__ import annotations

import importlib
import logging
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from altd.calibration.report.identity import PAGE_SUFFIX, SHEETS_SUFFIX
from altd.errors import BadInputError
from altd.files.writing import check_replaceable, write_files


def report_names(calibration: Path) -> tuple[str, str]:
    """Page and sheets of the report on the calibration of this file.

    Raises BadInputError where one of them has the file's own name.
    """
    names = calibration.stem + PAGE_SUFFIX, calibration.stem + SHEETS_SUFFIX
    if calibration.name in names:
        raise BadInputError(calibration, "is what its report would be called; possible: calibration.json")
    return names


def check_report(folder: Path, names: Sequence[str]) -> None:
    """Say before any work is done what would stop a report: no matplotlib, a folder that cannot be written.

    ``names`` are those of its files. Leaves nothing behind. Raises BadInputError.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # the first time, it tells of its font cache
    try:
        importlib.import_module("matplotlib")
    except ImportError as error:
        raise BadInputError(
            "--report", "needs matplotlib, which comes with the extra altd[report]"
        ) from error
    try:
        is_new = _make_folder(folder)
        descriptor, trial = tempfile.mkstemp(dir=folder, prefix=".trial.")
        os.close(descriptor)
        Path(trial).unlink()
        for name in names:
            check_replaceable(folder / name)
        if is_new:
            folder.rmdir()
    except OSError as error:
        raise BadInputError(folder, error.strerror or "cannot be written") from error


def _make_folder(folder: Path) -> bool:
    """Whether the folder had to be made."""
    try:
        folder.mkdir()
    except FileExistsError:
        if not folder.is_dir():
            raise BadInputError(folder, "is not a folder") from None
        return False
    return True


def write_together(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into the folder, made when it is not there, all or none; older ones are replaced.

    Raises BadInputError when one cannot be written; then all are as they were.
    """
    try:
        is_new = _make_folder(folder)
        try:
            write_files({folder / name: content for name, content in files.items()})
        except BaseException:
            if is_new:
                with suppress(OSError):  # somebody else has put something there
                    folder.rmdir()
            raise
    except OSError as error:
        raise BadInputError(folder, error.strerror or "cannot be written") from error
