"""Numbers of things in sentences."""


def counted(number: int, thing: str) -> str:
    """``1 frame``, ``2 frames``: the number and the thing, whose plural takes an s."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
