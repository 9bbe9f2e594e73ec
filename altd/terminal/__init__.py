"""What a character screen shows of a unit: the daemon's documents as lines of text; knows no terminal."""
