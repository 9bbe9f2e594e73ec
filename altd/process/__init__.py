"""The log, the standard streams, and how a process ends."""
