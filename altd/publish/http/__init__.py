"""HTTP: the measurement, the unit's status, a stream, and a page for a person."""
