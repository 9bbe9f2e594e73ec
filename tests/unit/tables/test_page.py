from support.places import DOCS

from altd.instruments.beam.instrument import QUANTITIES
from altd.tables import AXIS_COLUMNS, POINT_COLUMNS, SPOT_COLUMNS, measurement_columns
from tools.pages.tables import page


def test_the_page_is_generated_from_the_code() -> None:
    assert (DOCS / "tables.md").read_text() == page(), "run: make pages"


def test_no_name_stands_twice_and_units_are_those_of_the_names() -> None:
    measured = measurement_columns(QUANTITIES, ("front", "rear"), True)
    for columns in (measured, POINT_COLUMNS, SPOT_COLUMNS, AXIS_COLUMNS):
        names = [column.name for column in columns]
        assert len(set(names)) == len(names)
        for column in columns:
            endings = {"mm": "_mm", "°": "_deg", "mm/m": "_mm_per_m", "px": "_px", "s": "_s", "m": "_m"}
            ending = endings.get(column.unit, "")
            assert column.name.endswith(ending)
