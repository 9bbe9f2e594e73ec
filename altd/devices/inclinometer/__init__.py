"""Modbus RTU inclinometers: a sensor is described by a table of registers."""
