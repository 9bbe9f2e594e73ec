"""The credentials as the file has them now: who is taken out of it can act no more, without a restart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from altd.credentials.file import Credentials, load_credentials
from altd.errors import BadInputError

_Stamp = tuple[int, int, int, int] | None


class CredentialsKeeper:
    """Reads the file again whenever it is another one.

    ``complain`` is told of one that cannot be used, and with an empty text of one that can. With one that
    cannot, nobody may act: who takes a file away means that. Raises BadInputError when it cannot be used at
    the start.
    """

    def __init__(self, path: Path, complain: Callable[[str], object] = lambda _: None) -> None:
        self._path = path
        self._complain = complain
        self._stamp = self._stamp_now()
        self._known = load_credentials(path)

    def current(self) -> Credentials:
        """Who may act at this moment."""
        stamp = self._stamp_now()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._known = load_credentials(self._path)
                self._complain("")
            except BadInputError as error:
                self._known = Credentials()
                self._complain(str(error))
        return self._known

    def _stamp_now(self) -> _Stamp:
        try:
            found = self._path.stat()
        except (OSError, ValueError):
            return None
        return found.st_mtime_ns, found.st_ino, found.st_size, found.st_mode
