"""Results of ``replay``, ``locate`` and ``map``, on standard output or into a file."""
