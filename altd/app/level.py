"""``altd level``: reads the inclinometer in known positions, and stores what aligns its axes to the unit."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from altd.acquisition.inclination.alignment import Alignment, Position, align
from altd.acquisition.inclination.judging import InclinationJudge
from altd.config import InclinometerSettings
from altd.devices.inclinometer import SensorSettings
from altd.errors import BadInputError
from altd.files.documents import checksummed, parse_checksummed
from altd.files.reading import check_rights, read_file
from altd.files.table import Celsius, Table
from altd.files.writing import write_file
from altd.ports import Inclinometer, InclinometerError, InclinometerReading
from altd.records import utc_text

READINGS = 50
"""Readings in each position."""
_FORMAT = "altd-level/1"
_MAX_BYTES = 1 << 20
_MAX_DEVIATION = 5.0
"""Largest deviation of a position, in standard deviations: with 20 of them 3 is common."""

_Degrees = Annotated[float, Field(ge=-180, le=360)]
_Positive = Annotated[float, Field(gt=0, le=45)]


class LevelPosition(Table):
    """The sensor's mean angles, after the signs of the settings, in one position of the unit."""

    plate_deg: tuple[_Degrees, _Degrees]
    turned_deg: _Degrees
    roll_deg: _Degrees
    pitch_deg: _Degrees | None
    sigma_deg: _Positive
    """Standard uncertainty of the mean angles: specification of the sensor and scatter."""
    temperature_c: Celsius


class LevelDocument(Table):
    """File of a levelling. The alignment is computed from the positions whenever it is read."""

    format: str
    unit: str
    sensor: str
    sheet: SensorSettings | None
    """Data sheet of a sensor that the settings describe: scale and sense of its angles are those of it."""
    made: datetime
    made_by: str
    sign_roll: int
    sign_pitch: int
    plate_sigma_deg: _Positive
    roll_is_inclination: bool
    positions: Annotated[tuple[LevelPosition, ...], Field(min_length=2, max_length=20)]

    def alignment(self) -> Alignment:
        """Return the alignment; raises ValueError if the positions contradict each other."""
        positions = [
            Position(of.plate_deg, of.turned_deg, (of.roll_deg, of.pitch_deg), of.sigma_deg)
            for of in self.positions
        ]
        celsius = float(np.mean([of.temperature_c for of in self.positions]))
        found, deviation = align(positions, self.plate_sigma_deg, self.roll_is_inclination, celsius)
        if not deviation <= _MAX_DEVIATION:
            raise ValueError(
                f"the positions contradict each other by {deviation:.0f} standard deviations: check the "
                "signs, the direction in which the unit was turned, and the plates' tilt"
            )
        return found


def alignment_of(settings: InclinometerSettings, unit: str) -> Alignment | None:
    """Return the alignment of the settings' file of ``altd level``; None: they name none.

    Raises BadInputError if the file is not of this unit, sensor and signs.
    """
    if (path := settings.level) is None:
        return None
    check_rights(path)
    try:
        content = LevelDocument.model_validate(parse_checksummed(read_file(path, _MAX_BYTES), _FORMAT))
        for what, there, here in (
            ("unit", content.unit, unit),
            ("sensor", content.sensor, settings.type_name),
            ("sign_roll", content.sign_roll, settings.sign_roll),
            ("sign_pitch", content.sign_pitch, settings.sign_pitch),
        ):
            if there != here:
                raise ValueError(f"was made with {what} {there!r}, not {here!r}: level again, altd level")
        if content.sheet != settings.sensor:
            raise ValueError("was made with another [inclinometer.sensor]: level again, altd level")
        return content.alignment()
    except ValidationError as error:
        first = error.errors()[0]
        raise BadInputError(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error


def take_level(  # noqa: PLR0913  a sensor, its positions, and a guide
    driver: Inclinometer,
    settings: InclinometerSettings,
    unit: str,
    plan: Sequence[tuple[float, float, float]],
    plate_sigma_deg: float,
    made_by: str,
    ask: Callable[[int], object],
    pause: Callable[[float], object] = time.sleep,
) -> LevelDocument:
    """Read the sensor in each position (roll, pitch, turned) of ``plan``, after ``ask`` with its number.

    Raises BadInputError that names the position whose readings are not credible.
    """
    try:
        driver.open()
        try:
            positions = []
            for number, place in enumerate(plan):
                ask(number)
                readings = list(_readings(driver, settings, pause))
                positions.append(_position(readings, settings, driver, place, number))
        finally:
            driver.close()
    except InclinometerError as error:
        raise BadInputError(settings.device, str(error)) from error
    return LevelDocument(
        format=_FORMAT,
        unit=unit,
        sensor=settings.type_name,
        sheet=settings.sensor,
        made=datetime.now(UTC),
        made_by=made_by,
        sign_roll=settings.sign_roll,
        sign_pitch=settings.sign_pitch,
        plate_sigma_deg=plate_sigma_deg,
        roll_is_inclination=driver.accuracy.roll_is_inclination,
        positions=tuple(positions),
    )


def save_level(document: LevelDocument, path: Path) -> None:
    """Write the file completely or not at all; raises BadInputError."""
    write_file(path, checksummed(document.model_dump(mode="json") | {"made": utc_text(document.made)}))


def report(alignment: Alignment) -> Iterator[str]:
    """Yield what a levelling showed, in lines."""
    a, b, c, d = np.degrees(alignment.axes)
    sigmas = np.degrees(np.sqrt(np.diag(alignment.covariance)))
    yield f"zero of roll {a:+.4f} deg (u {sigmas[0]:.4f}), of pitch {d:+.4f} deg (u {sigmas[3]:.4f})"
    yield f"turn of the axes: roll {b:+.3f} deg (u {sigmas[1]:.3f}), pitch {c:+.3f} deg (u {sigmas[2]:.3f})"
    for tilt_deg in (0.0, 5.0):
        tilt = alignment.tilt(tilt_deg, tilt_deg, 0.0)
        yield (
            f"with both angles at {tilt_deg:g} deg this levelling adds {tilt.sigma_roll_deg:.4f} deg "
            f"to sigma of roll, {tilt.sigma_pitch_deg:.4f} deg to that of pitch"
        )


def _readings(
    driver: Inclinometer, settings: InclinometerSettings, pause: Callable[[float], object]
) -> Iterator[InclinometerReading]:
    for _ in range(READINGS):
        yield driver.read()
        pause(settings.interval_s)


def _position(
    readings: Sequence[InclinometerReading],
    settings: InclinometerSettings,
    driver: Inclinometer,
    place: tuple[float, float, float],
    number: int,
) -> LevelPosition:
    judge = InclinationJudge(settings.model_copy(update={"max_roll_deg": 90.0}), driver.accuracy)
    said = [judge.roll(reading) for reading in readings][-1]
    if said.value is None:
        raise BadInputError(f"position {number + 1}", said.detail)
    rolls_deg = settings.sign_roll * np.array([of.roll_deg for of in readings])
    pitches_deg = settings.sign_pitch * np.array([of.pitch_deg or 0.0 for of in readings])
    half = len(readings) // 2
    scatter_deg = max(float(rolls_deg.std()), float(pitches_deg.std()))
    moved_deg = max(abs(float(of[:half].mean() - of[half:].mean())) for of in (rolls_deg, pitches_deg))
    if moved_deg > 3 * judge.credible[-1].sensor_deg:
        raise BadInputError(f"position {number + 1}", f"the unit moved by {moved_deg:.3f} deg meanwhile")
    return LevelPosition(
        plate_deg=place[:2],
        turned_deg=place[2],
        roll_deg=float(rolls_deg.mean()),
        pitch_deg=None if readings[0].pitch_deg is None else float(pitches_deg.mean()),
        sigma_deg=float(np.hypot(judge.credible[-1].sensor_deg, scatter_deg / np.sqrt(len(readings)))),
        temperature_c=float(np.mean([of.temperature_c for of in readings])),
    )
