"""The parts and the place of a report, and writing all of its files or none."""

from __future__ import annotations

import importlib
import logging
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from altd.calibration.result import TargetEvidence
from altd.errors import BadInputError
from altd.files.writing import check_replaceable, write_files
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.recording.header import RecordingHeader
from altd.records import PixelArray

PAGE_SUFFIX, SHEETS_SUFFIX, BUDGET_SUFFIX, DCC_SUFFIX = ".html", ".pdf", "-budget.json", ".xml"

HEAD_BYTES = 1024
"""Number of first bytes of a report's page that contain the checksum of the calibration."""

_NAMED = re.compile(rb'<meta name="altd-calibration" content="(sha256:[0-9a-f]{64})">')


def meta_line(checksum: str) -> str:
    """Element of a page's head that identifies the calibration by the checksum in its file."""
    return f'<meta name="altd-calibration" content="{checksum}">'


def checksum_in(head: bytes) -> str | None:
    """Checksum of a page's calibration, from the page's first bytes; None if it contains none."""
    named = _NAMED.search(head[:HEAD_BYTES])
    return None if named is None else named[1].decode("ascii")


def page_path(calibration: Path) -> Path:
    """Expected path of the page on a calibration file: next to it, with the same name."""
    return calibration.with_suffix(PAGE_SUFFIX)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """The subject of a report: the calibration, its evidence and its origin.

    ``negatives`` are the scan's pictures by target, see ``scan_negatives``; a target may lack one.
    ``headers`` are those of the recordings, in the order in which they were given.
    """

    calibration: Calibration
    evidence: tuple[TargetEvidence, ...]
    negatives: Mapping[str, PixelArray]
    command: str
    headers: tuple[RecordingHeader, ...]

    def targets(self) -> list[tuple[TargetCalibration, TargetEvidence]]:
        """Each target with its evidence."""
        known = {seen.name: seen for seen in self.evidence}
        return [(target, known[target.name]) for target in self.calibration.targets]


def target_names_text(targets: Sequence[TargetCalibration]) -> str:
    """Phrase for all the targets within a sentence."""
    return {1: "the target", 2: "both targets"}.get(len(targets), "all targets")


def report_names(calibration: Path, is_certificate: bool = False) -> tuple[str, ...]:
    """Names of page, sheets and budget of the report on a calibration file, and of a certificate's XML.

    Raises BadInputError if one of them equals the calibration file's own name.
    """
    suffixes = (PAGE_SUFFIX, SHEETS_SUFFIX, BUDGET_SUFFIX, *([DCC_SUFFIX] if is_certificate else []))
    names = tuple(calibration.stem + suffix for suffix in suffixes)
    if calibration.name in names:
        raise BadInputError(calibration, "is reserved for its report; possible: calibration.json")
    return names


def check_report(folder: Path, names: Sequence[str], option: str = "--report") -> None:
    """Check in advance that a report can be written: matplotlib is installed, the folder is writable.

    ``names`` are those of its files, ``option`` is the argument that requests it. Leaves no files behind.
    Raises BadInputError.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # the first import logs its font cache
    try:
        importlib.import_module("matplotlib")
    except ImportError as error:
        raise BadInputError(option, "needs matplotlib, which comes with the extra altd[report]") from error
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
    """Create the folder if it does not exist; return whether it was created."""
    try:
        folder.mkdir()
    except FileExistsError:
        if not folder.is_dir():
            raise BadInputError(folder, "is not a folder") from None
        return False
    return True


def write_together(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files or none into the folder; create it if necessary, and replace older files.

    Raises BadInputError when one cannot be written; all are then unchanged.
    """
    try:
        is_new = _make_folder(folder)
        try:
            write_files({folder / name: content for name, content in files.items()})
        except BaseException:
            if is_new:
                with suppress(OSError):  # another process has put a file there
                    folder.rmdir()
            raise
    except OSError as error:
        raise BadInputError(folder, error.strerror or "cannot be written") from error
