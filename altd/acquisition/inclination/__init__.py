"""Roll from an inclinometer: read in a separate thread, judged, and added to the beam's measurement."""
