"""Verification of a unit with known beams, on the model of ISO 17123 (docs/verify.md)."""
