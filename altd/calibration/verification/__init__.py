"""A unit against known beams, in the manner of ISO 17123 (docs/verify.md)."""
