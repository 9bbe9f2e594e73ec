"""Clock, supervision, service manager, and threads for blocking calls."""
