"""What composes: the daemon, a replay, and the parts that a config asks for."""
