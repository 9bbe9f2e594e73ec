"""A simulated unit's own files, made as a technician makes them."""

from pathlib import Path

from support.cli import altd_here


def scan_and_calibrate(seed: int, folder: Path) -> None:
    """Leave ``scan``, a recording, ``cal.json`` and ``calibrated``, what was said, in a folder."""
    scanned = altd_here("scan", "-o", folder / "scan", "--seed", seed, module="hw_sim")
    assert scanned.status == 0, scanned.err
    calibrated = altd_here("calibrate", folder / "scan", "-o", folder / "cal.json")
    assert calibrated.status == 0, calibrated.err
    (folder / "calibrated").write_text(calibrated.out)
