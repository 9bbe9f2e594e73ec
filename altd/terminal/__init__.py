"""View of a unit on a character screen: the daemon's documents as lines of text, for any terminal."""
