"""Changing the file of credentials, as ``altd password`` and ``altd token`` do."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from altd.credentials.file import Credentials, is_name, load_credentials, save_credentials
from altd.errors import BadInputError

_OWNER_ALONE = 0o077


def check_name(name: str) -> None:
    """Raise BadInputError for a name that nobody can have."""
    if not is_name(name):
        text = f"{name[:40]!r} is no name; possible: small letters, digits and _, a letter first, up to 32"
        raise BadInputError("NAME", text)


def change(path: Path, name: str, changed: Callable[[Credentials], Credentials]) -> None:
    """Change what the file says of a name; a new file is for its owner alone.

    Raises BadInputError, also where a password or token is taken away that was never there; then the file is
    as it was.
    """
    check_name(name)
    before = load_credentials(path) if os.path.lexists(path) else Credentials()
    after = changed(before)
    if after == before:
        raise BadInputError(path, f"{name} has none that could be removed")
    umask = os.umask(_OWNER_ALONE)
    try:
        save_credentials(path, after)
    finally:
        os.umask(umask)
