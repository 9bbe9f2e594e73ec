"""Roll from an inclinometer: read in a thread of its own, judged, and put beside what the beam says."""
