"""Modbus TCP and RTU for the machine's controller: one register table, read only."""
