"""Settings that are no TOML."""

from __future__ import annotations

NO_TOML: tuple[tuple[str, str, str], ...] = (
    ("[unit]", "[unit«", "the ] after the name of a table is missing"),
    ('serial = "TEST-1"', 'serial = "TEST-1«', "the text in quotes does not end on its line"),
    ('serial = "TEST-1"', "serial = «TEST-1", "no value: put text in quotes"),
    ("window = 20", "window = 20 «exposures", "the line should end here"),
    ("window = 20", "window «20", "the = after a key is missing"),
    ("window = 20\nevery = 1", "window = 20\n«window = 21", "this key is defined twice"),
    ("[http]", "«[modbus_tcp]", "this table is defined twice"),
    ('["LED_FRONT", "LED_REAR"]', '["LED_FRONT" «"LED_REAR"]', "a comma or ] is missing in a list"),
    ("{ gain = 16 }", "{ gain = 16«", "a comma or } is missing in a table"),
    ("active_low = false", "active_low = «False", "true and false in small letters"),
)
"""What is no TOML: what is replaced, what by, words of the complaint."""
