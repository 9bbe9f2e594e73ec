"""The log, the standard streams, and the end of a process."""
