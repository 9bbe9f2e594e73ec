"""What ``replay``, ``locate`` and ``map`` answer, on standard output or into a file."""
