"""The ways to disturb measurements, by what they disturb."""
