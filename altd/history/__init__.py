"""Measurements and events of the unit, in a SQLite file that survives restarts and power cuts."""
