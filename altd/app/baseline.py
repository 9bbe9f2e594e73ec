"""Stores the baseline of a row of targets in a file, so that a restart does not reset it to zero."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from altd.app.settings import service_folder
from altd.config import Config, RowSettings
from altd.errors import BadInputError
from altd.files.documents import checksummed, parse_checksummed
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.instruments.row.displacement import BaselineMeans
from altd.instruments.row.frames import RowChain
from altd.instruments.row.places import BeamPlace
from altd.measuring.calibration import Calibration
from altd.reasons import Reason
from altd.records import FloatArray, utc_text
from altd.runtime.service_manager import state_folder
from altd.runtime.threads import call_in_thread
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.proof import unit_number

_FORMAT = "altd-baseline/1"
_MAX_BYTES = 1 << 20
_RETRY_S = 10.0
_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
_Positive = Annotated[float, Field(allow_inf_nan=False, ge=0, le=1e6)]
_Matrix = tuple[tuple[_Number, _Number], tuple[_Number, _Number]]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False, frozen=True)


class _Spot(_Table):
    """Mean spot; see ``BeamPlace``."""

    mm: tuple[_Number, _Number]
    frames: Annotated[int, Field(ge=1)]
    random_mm2: _Matrix
    covariance_mm2: _Matrix
    mm_per_px: _Matrix
    excess_mm2: _Positive
    spot_sigma_mm: Annotated[float, Field(allow_inf_nan=False, gt=0, le=1e3)]
    stretch: tuple[_Number, _Number] | None = None


class _Content(_Table):
    unit: str
    calibration: str
    made: datetime
    origin: Literal["camera", "simulated"]
    own: Mapping[str, _Spot]
    stable: Mapping[str, Mapping[str, _Spot]]


@dataclass(frozen=True, slots=True)
class BaselineFile:
    """Baseline file of one unit, for one calibration and the stable targets of its config."""

    path: Path
    calibration: Calibration
    settings: RowSettings

    def load(self) -> BaselineMeans | None:
        """Read the file; None: no file yet. Raises BadInputError if it is damaged or of another row."""
        if not os.path.lexists(self.path):
            return None
        try:
            return self._means(parse_checksummed(read_file(self.path, _MAX_BYTES), _FORMAT))
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise BadInputError(self.path, f"{key}: {first['msg']}") from error
        except ValueError as error:
            raise BadInputError(self.path, str(error)) from error

    def save(self, means: BaselineMeans, made: datetime, simulated: bool) -> None:
        """Write the file completely or not at all; raises BadInputError."""
        document: dict[str, Any] = {
            "format": _FORMAT,
            "unit": self.calibration.unit_serial,
            "calibration": self._checksum,
            "made": utc_text(made),
            "origin": "simulated" if simulated else "camera",
            "own": {name: _spot(place) for name, place in means.own.items()},
            "stable": {
                name: {other: _spot(place) for other, place in of.items()}
                for name, of in means.stable.items()
            },
        }
        write_file(self.path, checksummed(document))

    @property
    def _checksum(self) -> str:
        return "" if self.calibration.file is None else self.calibration.file.checksum

    def _means(self, document: dict[str, Any]) -> BaselineMeans:
        del document["format"]
        content = _Content.model_validate(document)
        if content.unit != self.calibration.unit_serial:
            raise ValueError(f"is of unit {content.unit!r}, not of {self.calibration.unit_serial!r}")
        if content.calibration != self._checksum:
            raise ValueError("is of another calibration: make a new one, altd baseline")
        names = self.calibration.target_names
        if unknown := sorted((content.own.keys() | content.stable.keys()) - set(names)):
            raise ValueError(f"has target {unknown[0]!r}, which is not in the calibration")
        stable = [name for name in self.settings.stable if name in content.own]  # others were left out
        for name in content.own:
            if missing := [of for of in stable if of not in content.stable.get(name, {})]:
                raise ValueError(
                    f"{missing[0]!r} was not a stable target then: make a new one, altd baseline"
                )
        return BaselineMeans(
            {name: _place(spot) for name, spot in content.own.items()},
            {
                name: {other: _place(spot) for other, spot in of.items()}
                for name, of in content.stable.items()
            },
            content.origin == "simulated",
        )


def baseline_file(config: Config, calibration: Calibration) -> BaselineFile | None:
    """Return the baseline file of a config; None: the config names none."""
    settings = config.chain or RowSettings()
    return None if settings.baseline is None else BaselineFile(settings.baseline, calibration, settings)


def baseline_path(config: Config, folder: Path) -> Path:
    """Return the path of a config's baseline file; in ``folder`` if the config names none."""
    named = None if config.chain is None else config.chain.baseline
    return named or folder / f"baseline-{unit_number(config.unit.serial):08X}.json"


def with_baseline_kept(config: Config, place: Path) -> Config:
    """Return the config with a file for its baseline, in the service's folder if it names none.

    Raises BadInputError if there is neither: a restart would reset the baseline to zero.
    """
    settings, folder = config.chain or RowSettings(), state_folder()
    if settings.baseline is None and folder is None:
        why = "missing, and there is no service folder: a restart would reset the baseline to zero"
        raise BadInputError(place, f"chain.baseline: {why}; possible: a file")
    path = baseline_path(config, service_folder(place))
    return config.model_copy(update={"chain": settings.model_copy(update={"baseline": path})})


@dataclass(eq=False)
class BaselineKeeper:
    """Writes the baseline made by a daemon's first rounds. A baseline from a recording is not kept."""

    chain: RowChain
    board: Board
    file: BaselineFile
    component: Component

    @classmethod
    def of(
        cls, config: Config, calibration: object, chain: object, board: Board, health: Health
    ) -> Self | None:
        """Return the keeper for a row whose config names a file; None: there is nothing to keep."""
        if not isinstance(chain, RowChain) or not isinstance(calibration, Calibration):
            return None
        file = baseline_file(config, calibration)
        return None if file is None else cls(chain, board, file, health.component("baseline"))

    async def run(self) -> None:
        """Wait for the baseline and write it; retry if the write fails."""
        if (means := self.chain.baseline) is not None:
            self.component.set_state(State.OK, f"that of {self.file.path}")
            return
        cursor, measurement = self.board.cursor(), None
        self.component.set_state(State.OK, "is being made")
        while means is None or measurement is None:
            measurement = await cursor.next()
            means = self.chain.baseline
        reasons = {fault.reason for fault in measurement.status}
        if Reason.PLAYBACK in reasons:
            self.component.set_state(State.OK, "that of a recording is not kept")
            return
        clock = self.component.clock
        made = clock.utc(clock.monotonic_ns()) or datetime.now(UTC)
        while True:
            try:
                save = partial(self.file.save, means, made, Reason.SIMULATED in reasons)
                await call_in_thread(save, "baseline")
            except BadInputError as error:
                self.component.set_state(State.FAILED, f"{error}; trying again")
                await clock.sleep(_RETRY_S)
            else:
                self.component.set_state(State.OK, f"kept in {self.file.path}")
                return


def _spot(place: BeamPlace) -> dict[str, Any]:
    return {
        "mm": place.mm.tolist(),
        "frames": place.frames,
        "random_mm2": place.random_mm2.tolist(),
        "covariance_mm2": place.covariance_mm2.tolist(),
        "mm_per_px": place.mm_per_px.tolist(),
        "excess_mm2": place.excess_mm2,
        "spot_sigma_mm": place.spot_sigma_mm,
        "stretch": place.stretch,
    }


def _place(spot: _Spot) -> BeamPlace:
    """Return the place of a stored spot; its time is 0, as it has no meaning in another run."""
    return BeamPlace(
        t_ns=0,
        frames=spot.frames,
        mm=np.array(spot.mm),
        random_mm2=_covariance(spot.random_mm2),
        covariance_mm2=_covariance(spot.covariance_mm2),
        excess_mm2=spot.excess_mm2,
        spot_sigma_mm=spot.spot_sigma_mm,
        mm_per_px=np.array(spot.mm_per_px),
        stretch=spot.stretch,
    )


def _covariance(matrix: _Matrix) -> FloatArray:
    covariance = np.array(matrix)
    is_symmetric = np.allclose(covariance, covariance.T, rtol=1e-9, atol=1e-12)  # a stored one always is
    if not is_symmetric or np.linalg.eigvalsh(covariance)[0] < 0.0:
        raise ValueError("has an invalid covariance")
    return covariance
