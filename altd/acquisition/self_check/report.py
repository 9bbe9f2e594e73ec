"""A check's report: for a person in a sentence, for a program as plain JSON types (DESIGN §5)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from altd.acquisition.self_check.judging import Judged
from altd.acquisition.self_check.schedule import Cause
from altd.records import utc_text
from altd.selfcheck.as_object import as_object
from altd.status.self_check_desk import SelfCheckReport


@dataclass(frozen=True, slots=True)
class Occasion:
    """Which check it was, what for, when it ended, and how many exposures it took from the measurement."""

    number: int
    cause: Cause
    time: datetime | None
    exposures_lost: int


def report_of(occasion: Occasion, judged: Judged) -> SelfCheckReport:
    """What a check said."""
    check = judged.check
    return SelfCheckReport(
        occasion.number,
        judged.sentence,
        {
            **as_object(check),
            "number": occasion.number,
            "cause": str(occasion.cause),
            "time": None if occasion.time is None else utc_text(occasion.time),
            "exposures_lost": occasion.exposures_lost,
            "notes": list(judged.notes),
        },
    )
