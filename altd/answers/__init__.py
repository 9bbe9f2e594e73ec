"""Results of commands such as ``replay``, ``locate`` and ``map``, on standard output or in a file."""
