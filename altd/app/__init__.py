"""Composition: the daemon, a replay, and the parts that a config requires."""
