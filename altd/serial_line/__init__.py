"""Serial lines: opening a port, and the CRC of Modbus RTU."""
