"""Pure code: from a frame to its spot, or the reason why there is none."""
