"""Frame LEDs and indicators kept as they should be."""
