"""Listening on TCP ports, for publishers: connections come one at a time, and never the last descriptors."""
