"""The ways to spoil measurements, by what they spoil."""
