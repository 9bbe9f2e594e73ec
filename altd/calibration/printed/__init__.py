"""Find the print of a target in the frames of its own scan, if no flat was recorded."""
