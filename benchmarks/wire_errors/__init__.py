"""Errors on the wires between a unit and the reader of ``docs/proof.md``, and which of them it detects."""
