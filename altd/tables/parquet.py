"""Tables as Parquet, with types, units and where they come from; needs pyarrow, the extra ``parquet``."""

from __future__ import annotations

import importlib
import io
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from altd.errors import BadInputError
from altd.tables.columns import Column, Row, Type

if TYPE_CHECKING:
    import pyarrow

MAX_ROWS_HELD = 8192
"""Of a row group, which is what is held: 2 MB."""


def check_parquet() -> None:
    """Say before any work is done that pyarrow is missing; raises BadInputError."""
    try:
        importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise BadInputError(
            "--format parquet", "needs pyarrow, which comes with the extra altd[parquet]"
        ) from error


class _Sink(io.RawIOBase):
    """A file that takes what is written and, once it is closed, drops it.

    pyarrow's writer writes its footer when it is destroyed, also after a signal or a full disk has ended the
    work; that must not raise.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        return len(data) if self._file.closed else self._file.write(data)


class ParquetTable:
    """Rows into a file that is open; ``about`` becomes the file's metadata, each value as JSON.

    A column's unit and meaning are in the metadata of its field.
    """

    def __init__(self, file: BinaryIO, columns: Sequence[Column], about: Mapping[str, Any]) -> None:
        import pyarrow.parquet

        self._schema = pyarrow.schema(
            [_field(column) for column in columns],
            {f"altd.{key}": json.dumps(value, allow_nan=False) for key, value in about.items()},
        )
        self._times = [column.name for column in columns if column.type is Type.TIME]
        self._rows: list[dict[str, Any]] = []
        sink = _Sink(file)
        self._writer = pyarrow.parquet.ParquetWriter(sink, self._schema, compression="snappy", version="2.6")

    def add(self, row: Row) -> None:
        """A row; what it does not have is null."""
        times = {name: _moment(row.get(name)) for name in self._times}
        self._rows.append({**row, **times})
        if len(self._rows) >= MAX_ROWS_HELD:
            self._flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write what is left and the footer, without which it is no Parquet file."""
        if kind is None:
            if self._rows:
                self._flush()
            self._writer.close()

    def _flush(self) -> None:
        import pyarrow

        self._writer.write_table(pyarrow.Table.from_pylist(self._rows, self._schema))
        self._rows.clear()


def _field(column: Column) -> pyarrow.Field:
    import pyarrow

    types = {
        Type.WHOLE: pyarrow.int64(),
        Type.NUMBER: pyarrow.float64(),
        Type.TRUTH: pyarrow.bool_(),
        Type.TEXT: pyarrow.string(),
        Type.TIME: pyarrow.timestamp("ms", tz="UTC"),
    }
    about = {"meaning": column.meaning} | ({"unit": column.unit} if column.unit else {})
    return pyarrow.field(column.name, types[column.type], metadata=about)


def _moment(text: object) -> datetime | None:
    return None if text is None else datetime.fromisoformat(str(text))
