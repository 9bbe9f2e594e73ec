"""The simulated unit as hardware: its cameras on the network over GigE Vision."""
