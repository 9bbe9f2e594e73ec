"""The print of a target, found in the frames of its own scan, where no flat was recorded."""
