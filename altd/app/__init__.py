"""Composition of the daemon, of a replay, and of the parts that a config requires."""
