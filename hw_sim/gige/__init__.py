"""The simulated unit as hardware: its cameras on the network, by GigE Vision."""
