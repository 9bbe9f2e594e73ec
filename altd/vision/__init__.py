"""Pure: frame → spot, or the reason why there is none."""
