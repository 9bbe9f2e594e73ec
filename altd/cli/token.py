"""``altd token``: makes or removes tokens of programs that may act on the unit."""

from __future__ import annotations

import argparse

from altd.cli.arguments import add_credentials
from altd.process.standard_streams import print_lines

SUMMARY = "make or remove a token for the unit's API; print a new one once"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_credentials(parser)


def run(options: argparse.Namespace) -> int:
    """Write the hash of a new token, and print the token: it is shown only once."""
    from altd.credentials.file import change
    from altd.credentials.hashes import new_token, token_digest

    if options.remove:
        change(options.file, options.name, lambda known: known.with_token(options.name, None))
        print_lines(f"{options.file}: {options.name} has no token")
        return 0
    token = new_token()
    change(options.file, options.name, lambda known: known.with_token(options.name, token_digest(token)))
    print_lines(token)
    return 0
