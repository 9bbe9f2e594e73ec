"""Finds faults of this computer for a config, each with the command that repairs it."""
