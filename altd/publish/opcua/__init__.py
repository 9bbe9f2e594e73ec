"""OPC UA: measurements, state and identity in the address space of a server, in a separate process."""
