"""Facts of a calibration certificate that a person must supply, from a TOML file (docs/calibrate.md)."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated

from pydantic import Field

from altd.config.loading import load_tables
from altd.errors import BadInputError
from altd.files.table import Table

Text = Annotated[str, Field(min_length=1, max_length=400)]
Country = Annotated[str, Field(pattern="^[A-Z]{2}$")]


class Contact(Table):
    """A laboratory or a customer."""

    name: Text
    email: Text
    street: Text | None = None
    post_code: Text | None = None
    city: Text
    country: Country
    """Country code of two letters, ISO 3166."""
    code: Text | None = None
    """Code of an accredited laboratory."""


class Operator(Table):
    """The person who calibrated and signs."""

    name: Text
    role: Text = "operator"


class UnitFacts(Table):
    """Maker and type of the unit."""

    manufacturer: Text
    model: Text


class Environment(Table):
    """The surroundings during the scan."""

    temperature_c: Annotated[float, Field(ge=-50, le=100)]
    temperature_expanded_k: Annotated[float, Field(gt=0, le=50)]
    """Expanded uncertainty (k = 2) of the temperature, K, including its change during the scan."""


class Equipment(Table):
    """An item of measuring equipment, such as the stage or the laser."""

    name: Text
    manufacturer: Text
    model: Text
    serial: Text
    certificate: Text | None = None
    """Number of its calibration certificate; without one, it is not traceable."""
    calibrated_by: Text | None = None
    valid_until: date | None = None


class Traceability(Table):
    """Origin of the references whose uncertainties are the scan's limits, such as a certificate's number."""

    stage: Text | None = None
    """Length, straightness and right angle of the stage's axes."""
    beam: Text | None = None
    """Direction of the calibrating beam against the targets' normal."""
    distance: Text | None = None
    """Distance between the targets."""


class Facts(Table):
    """Contents of the file."""

    number: Text
    """Number of the certificate."""
    performed: date
    valid_until: date | None = None
    procedure: Text = "altd: Calibrating a unit (docs/calibrate.md)"
    laboratory: Contact
    customer: Contact
    operator: Operator
    unit: UnitFacts
    environment: Environment
    traceability: Traceability = Traceability()
    as_found: Text | None = None
    """Errors before this calibration, such as those by ``altd verify`` with the calibration before."""
    equipment: Annotated[tuple[Equipment, ...], Field(min_length=1)]


def load_facts(path: Path) -> Facts:
    """Read and check a file; raises BadInputError with a message for each fault, with its line and key."""
    facts = load_tables(path, Facts)
    if facts.valid_until is not None and facts.valid_until <= facts.performed:
        raise BadInputError(path, "valid_until: is not after performed")
    return facts
