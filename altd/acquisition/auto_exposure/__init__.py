"""Choice and application of a camera's next exposure time and gain."""
