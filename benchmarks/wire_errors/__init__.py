"""Errors put on the wires between a unit and the reader of ``docs/proof.md``: which ones it finds."""
