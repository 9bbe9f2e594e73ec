"""The whole unit over a real wire: simulated cameras as processes, ``altd run``, and its readers."""
