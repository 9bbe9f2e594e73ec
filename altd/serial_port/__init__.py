"""Serial ports of interfaces and devices: opened in one way, written and read inside the event loop."""
