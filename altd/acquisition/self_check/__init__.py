"""The self-check in the daemon: its schedule, the frames under lit LEDs, and the effect on measurements."""
