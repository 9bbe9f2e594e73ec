"""``altd diagnose``: writes the diagnostics of a unit into one archive, without its page."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from altd.cli.arguments import add_socket
from altd.errors import BadInputError
from altd.process.standard_streams import print_errors, print_lines

SUMMARY = "write an archive for remote diagnostics, also while the daemon is not running"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_socket(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="archive to write (default: altd-SERIAL-TIME.zip)"
    )
    parser.add_argument(
        "--public",
        action="store_true",
        help="archive for a public issue, without names and addresses",
    )
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="DIR",
        help="with --public: ten pictures of this recording",
    )
    parser.add_argument(
        "--verification",
        type=Path,
        metavar="FILE",
        help="with --public: a file of `altd verify -o`",
    )
    parser.add_argument("--yes", action="store_true", help="with --public: do not ask")
    parser.add_argument("--no-journal", action="store_true", help="leave out the log of altd")


def run(options: argparse.Namespace) -> int:
    """Write the archive; if the daemon does not answer, from its files."""
    from altd.app.diagnostics import diagnose
    from altd.files.writing import write_file
    from altd.status.unit import DiagnosticPart

    if options.public:
        return _public(options)
    for option, value in (("--recording", options.recording), ("--verification", options.verification)):
        if value is not None:
            raise BadInputError(option, "requires --public")
    name, content, _ = diagnose(
        options.config,
        options.socket,
        [DiagnosticPart("doctor.txt", "findings of `altd doctor`", partial(_doctor, options.config))],
        lambda line: print_errors(f"altd diagnose: {line}"),
        with_journal=not options.no_journal,
    )
    write_file(output := options.output or Path(name), content)
    print_lines(str(output))
    return 0


def _public(options: argparse.Namespace) -> int:
    """Write the archive for a public issue, if the user agrees; return 1 if not."""
    from altd.app.public_archive import CONSENT, public_archive
    from altd.app.settings import SERVICE_CONFIG, load_settings
    from altd.files.writing import write_file

    config = load_settings(options.config or SERVICE_CONFIG)
    name, content = public_archive(config, options.recording, options.verification)
    print_errors(*CONSENT)
    if not options.yes and not _agrees():
        print_errors("altd diagnose: nothing is written")
        return 1
    write_file(output := options.output or Path(name), content)
    print_lines(str(output))
    return 0


def _agrees() -> bool:
    """Ask for consent; the end of input counts as no."""
    try:
        return input("Write it? (y: yes) ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _doctor(place: Path | None) -> bytes:
    """Return the findings; with settings that cannot be used, those of the computer."""
    from altd.doctor.checks import examine, in_lines

    try:
        findings = examine(place)
    except BadInputError as error:
        return "\n".join([*error.lines, *in_lines(examine(None)), ""]).encode()
    return "\n".join([*in_lines(findings), ""]).encode()
