"""The self-check in the daemon: when the frame LEDs are lit, which frames that concerns, and what follows."""
