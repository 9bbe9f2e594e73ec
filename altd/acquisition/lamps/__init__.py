"""Frame LEDs and indicators held at their setpoints."""
