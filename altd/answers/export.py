"""``altd export``: measurements or summaries from a history, as a table for other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from altd import __version__
from altd.answers.events import opened, time_text
from altd.errors import BadInputError
from altd.files.writing import check_replaceable
from altd.history.columns import StoredColumn as Stored
from altd.history.reader import Reader
from altd.history.records import StoredMeasurement, SummaryPoint
from altd.history.schema import HOURS, MINUTES, SECONDS
from altd.reasons import Signal
from altd.tables import Column, Format, Row, Type, Value, check_parquet, table_in, text

Every = Literal["measurement", "second", "minute", "hour"]
_TABLES = {"second": SECONDS, "minute": MINUTES, "hour": HOURS}
_EPOCH = Column("epoch", Type.WHOLE, "", "number of the clock's epoch, in which time only increases")
_SIGNALS = {signal.severity: str(signal) for signal in Signal}


def answer(
    history: Path, span_us: tuple[int, int], every: Every, form: Format, output: Path | None = None
) -> None:
    """Write the table, without ``output`` to standard output.

    Raises BadInputError; an existing file then stays as it was.
    """
    if form == "parquet":
        check_parquet(output)
    if output is not None:
        check_replaceable(output)
        if output.exists() and history.exists() and output.samefile(history):
            raise BadInputError(output, "is the input")
    with opened(history) as reader:
        columns = columns_of(reader, every)
        if len({column.name for column in columns}) < len(columns):
            raise BadInputError(history, "has two quantities of one name")
        with table_in(output, form, columns, _about(reader, history, every)) as add:
            for row in _rows(reader, every, span_us):
                add(row)


def columns_of(reader: Reader, every: Every) -> tuple[Column, ...]:
    """The columns of a table of measurements, or of summaries."""
    if every == "measurement":
        with_sigma = [stored for stored in reader.recorded.values() if "sigma" in stored.parts]
        return (
            Column("id", Type.WHOLE, "", "increases over restarts, unique in a file"),
            Column("time", Type.TIME, "", "UTC of the middle of the exposures that were averaged"),
            Column("sequence", Type.WHOLE, "", "number of the last exposure in the window"),
            Column("frames", Type.WHOLE, "", "exposures that were averaged"),
            Column("valid", Type.TRUTH, "", "whether the numbers may be used"),
            text("status", "reasons and warnings, codes with a space between them"),
            *(_of(stored, "", "value of") for stored in reader.recorded.values()),
            *(_of(stored, "sigma_", "combined standard uncertainty of") for stored in with_sigma),
            *(_of(stored, "sigma_random_", "scattering part of sigma of") for stored in with_sigma),
            _EPOCH,
        )
    kinds = {
        "": "mean over the valid measurements of",
        "sigma_": "standard deviation of one measurement of",
        "min_": "lowest valid",
        "max_": "highest valid",
    }
    return (
        Column("time", Type.TIME, "", "UTC of the beginning"),
        Column("n", Type.WHOLE, "", "measurements"),
        Column("n_valid", Type.WHOLE, "", "those that were valid"),
        text("worst", "the worst state of the unit, NAMUR NE 107"),
        text("worst_cause", "its cause"),
        text("lost_to", "the worst reason of the measurements that were not valid"),
        *(
            _of(stored, prefix, what)
            for stored in reader.summarised.values()
            for prefix, what in kinds.items()
        ),
        _EPOCH,
    )


def _of(stored: Stored, prefix: str, what: str) -> Column:
    return Column(prefix + _name(stored.key), Type.NUMBER, stored.unit, f"{what} {_name(stored.key)}")


def _name(key: str) -> str:
    return key.replace(".", "_")


def _rows(reader: Reader, every: Every, span_us: tuple[int, int]) -> Iterator[Row]:
    if every == "measurement":
        yield from map(_measurement_row, reader.measurements(*span_us))
    else:
        yield from map(_summary_row, reader.summaries(_TABLES[every], *span_us))


def _measurement_row(stored: StoredMeasurement) -> Row:
    return {
        "id": stored.id,
        "time": time_text(stored.t_us),
        "sequence": stored.sequence,
        "frames": stored.frames,
        "valid": stored.valid,
        "status": " ".join(stored.status),
        **{_name(key): value for key, value in stored.values.items()},
        **{f"sigma_{_name(key)}": sigma for key, sigma in stored.sigmas.items()},
        **{f"sigma_random_{_name(key)}": sigma for key, sigma in stored.randoms.items()},
        "epoch": stored.epoch,
    }


def _summary_row(point: SummaryPoint) -> Row:
    row: dict[str, Value] = {
        "time": time_text(point.t_us),
        "n": point.n,
        "n_valid": point.n_valid,
        "worst": _SIGNALS[point.worst],
        "worst_cause": point.worst_code,
        "lost_to": point.lost_to,
        "epoch": point.epoch,
    }
    for key, value in point.values.items():
        name = _name(key)
        row |= {
            name: value.mean,
            f"sigma_{name}": value.sigma,
            f"min_{name}": value.low,
            f"max_{name}": value.high,
        }
    return row


def _about(reader: Reader, history: Path, every: Every) -> dict[str, object]:
    """The origin of the numbers, for a reader of the table in ten years."""
    facts = reader.facts()
    return {
        "made_by": f"altd {__version__}",
        "unit_serial": facts.get("serial", "")[:100],
        "history": {"path": str(history), "every": every, "version": facts.get("version", "")},
        "calibration": facts.get("calibration", "")[:1000],
    }
