"""Clock, supervision, the service manager, threads for what blocks."""
