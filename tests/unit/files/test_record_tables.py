"""A table of a file that holds a record reads what it wrote, and names the key of what it refuses."""

from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from altd.files.record_tables import At, held_in, table_from


@dataclass(frozen=True)
class Pane:
    thickness_mm: float


@dataclass(frozen=True)
class Door:
    wood: str
    pane: Pane | None


@dataclass(frozen=True)
class House:
    town: str
    street: str
    door: Door
    windows: tuple[Pane, ...] = ()


class Address(BaseModel):
    town: str
    road: Annotated[str, At("street")]


class PaneTable(BaseModel):
    thickness_mm: Annotated[float, Field(gt=0)]


class HouseTable(BaseModel):
    format: Literal["house/1"]
    address: Annotated[Address, At("")]
    wood: Annotated[str, At("door.wood")]
    pane_mm: Annotated[float | None, At("door.pane.thickness_mm", or_absent=True)] = None
    windows: list[Annotated[Pane, held_in(PaneTable, Pane)]] = []


class HouseShown(BaseModel):
    town: str
    windows: Annotated[int, At("windows", len)]
    pane_mm: Annotated[float | None, At("door.pane.thickness_mm", round)]
    owner: str


FILE = TypeAdapter[House](Annotated[House, held_in(HouseTable, House)])
GLAZED = House("Ulm", "Wall", Door("oak", Pane(4.2)), (Pane(3.0),))
PLAIN = House("Ulm", "Wall", Door("oak", None))


@pytest.mark.parametrize("house", [GLAZED, PLAIN])
def test_a_record_is_read_as_it_was_written(house: House) -> None:
    document = FILE.dump_python(house, exclude_unset=True, warnings=False)
    assert document["address"] == {"town": "Ulm", "road": "Wall"}
    assert ("pane_mm" in document) == (house.door.pane is not None)
    read = FILE.validate_python(document)
    assert (read.town, read.street, read.door, list(read.windows)) == (
        house.town,
        house.street,
        house.door,
        list(house.windows),
    )


def test_what_is_refused_is_named_by_its_key() -> None:
    document = FILE.dump_python(GLAZED, exclude_unset=True, warnings=False)
    with pytest.raises(ValidationError) as caught:
        FILE.validate_python(document | {"windows": [{"thickness_mm": -1}], "address": {"town": "Ulm"}})
    places = [error["loc"] for error in caught.value.errors()]
    assert places == [("address", "road"), ("windows", 0, "thickness_mm")]


def test_an_answer_shows_values_of_the_record_and_those_that_are_given() -> None:
    shown = [table_from(HouseShown, house, owner="Berblinger").model_dump() for house in (GLAZED, PLAIN)]
    assert shown == [
        {"town": "Ulm", "windows": 1, "pane_mm": 4, "owner": "Berblinger"},
        {"town": "Ulm", "windows": 0, "pane_mm": None, "owner": "Berblinger"},
    ]
