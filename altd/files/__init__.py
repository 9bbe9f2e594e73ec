"""External files: limited before they are read, and written completely or not at all."""
