"""Inclinometers that speak Modbus RTU: a sensor is a table of registers."""
