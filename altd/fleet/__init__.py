"""Ingest from the broker into PostgreSQL, for many units; runs on another computer than a unit."""
