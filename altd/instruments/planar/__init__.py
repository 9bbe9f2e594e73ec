"""The planar pose of a plate (a, b, φ), and the kinematics of the source's planar 3-PRP machine."""
