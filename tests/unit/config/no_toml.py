"""Settings that are no TOML."""

from __future__ import annotations

from .whole_config import BASE

_FRONT_TARGET = BASE[BASE.index("[[targets]]") : BASE.rindex("[[targets]]") + 2]

NO_TOML: tuple[tuple[str, str, str], ...] = (
    ("[unit]", "[unit«", "the ] after the name of a table is missing"),
    ('serial = "TEST-1"', 'serial = "TEST-1«', "the text in quotes does not end on its line"),
    ('serial = "TEST-1"', "serial = «TEST-1", "no value: put text in quotes"),
    ("window = 20", "window = 20 «exposures", "a number is written without its unit"),
    ("window = 20", "window = 20«fps", "a number is written without its unit"),
    ("window = 20", "window = 20 «21", "the line should end here"),
    ("offset_yaw_deg = 0.25", "offset_yaw_deg = 0«,25", "the decimal sign is a point"),
    ("offset_yaw_deg = 0.25", "offset_yaw_deg = 0.25«°", "a number is written without its unit"),
    ('serial = "TEST-1"', "serial = «“TEST-1”", "these quotes are not straight"),
    ('serial = "TEST-1"', r'serial = "C:\P«rogram Files"', "put the text in single quotes"),
    ('serial = "TEST-1"', r'serial = "C:\U«sers"', "put the text in single quotes"),
    (
        _FRONT_TARGET,
        _FRONT_TARGET[1:].replace("]]", "]", 1).replace("\n[[", "\n«[["),
        "[[ ]] here a list of tables: write both alike",
    ),
    ("window = 20", "window «20", "the = after a key is missing"),
    ("window = 20\nevery = 1", "window = 20\n«window = 21", "this key is defined twice"),
    ("[http]", "«[modbus_tcp]", "this table is defined twice"),
    ('["LED_FRONT", "LED_REAR"]', '["LED_FRONT" «"LED_REAR"]', "a comma or ] is missing in a list"),
    ("{ gain = 16 }", "{ gain = 16«", "a comma or } is missing in a table"),
    ("active_low = false", "active_low = «False", "true and false in small letters"),
)
"""Texts that are no TOML: the text replaced, its replacement, words of the complaint."""
