"""Control of frame LEDs and indicators."""
