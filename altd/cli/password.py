"""``altd password``: sets or removes passwords for the unit's page."""

from __future__ import annotations

import argparse
import getpass
import sys

from altd.cli.arguments import add_credentials
from altd.errors import BadInputError
from altd.process.standard_streams import print_lines

SUMMARY = "set or remove a password for the unit's page and API"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_credentials(parser)


def run(options: argparse.Namespace) -> int:
    """Read a password, twice at a terminal, else from one line of standard input; write its hash."""
    from altd.credentials.file import change, check_name
    from altd.credentials.hashes import PasswordHash

    check_name(options.name)  # before anything is typed
    if options.remove:
        change(options.file, options.name, lambda known: known.with_password(options.name, None))
    else:
        password = PasswordHash.of(_typed(options.name))
        change(options.file, options.name, lambda known: known.with_password(options.name, password))
    print_lines(f"{options.file}: {options.name} has {'no password' if options.remove else 'a new password'}")
    return 0


def _typed(name: str) -> str:
    """Return the password; raises BadInputError if it is not permitted."""
    from altd.credentials.hashes import MAX_PASSWORD_BYTES, MIN_PASSWORD_CHARACTERS

    if sys.stdin.isatty():
        password = getpass.getpass(f"New password of {name}: ")
        if getpass.getpass("Once more: ") != password:
            raise BadInputError("password", "the passwords differ; nothing was changed")
    else:
        line = sys.stdin.buffer.readline(MAX_PASSWORD_BYTES + 2)
        try:
            password = line.decode().removesuffix("\n").removesuffix("\r")
        except UnicodeDecodeError as error:
            raise BadInputError("password", "is not UTF-8") from error
    if len(password) < MIN_PASSWORD_CHARACTERS or not password.isprintable():
        text = f"must have at least {MIN_PASSWORD_CHARACTERS} characters, all of them printable"
        raise BadInputError("password", text)
    if len(password.encode("utf-8", "replace")) > MAX_PASSWORD_BYTES:
        raise BadInputError("password", f"must have at most {MAX_PASSWORD_BYTES} bytes")
    return password
