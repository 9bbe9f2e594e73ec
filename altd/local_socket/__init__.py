"""The socket in the file system through which the unit's own computer speaks with its daemon: both ends."""
