"""Lamps on the lines of a GPIO chip, through the kernel's character device."""
