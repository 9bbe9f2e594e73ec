"""A simulated table that is quick, and what a scan has visited."""

from altd.recording.reader import Recording

QUICK_TABLE = {110: "300000", 111: "300000", 120: "100000", 121: "100000"}
"""Grbl's settings of rates and accelerations."""


def nodes(recording: Recording) -> list[tuple[float, float]]:
    """The nodes in the order of their frames, rounded to whole µm."""
    places = [row.position_mm for row in recording.rows if row.position_mm is not None]
    return list(dict.fromkeys((round(x, 2), round(y, 2)) for x, y in places))
