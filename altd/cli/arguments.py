"""Arguments of a command line: what is wrong with them in one line; all commands where none is given."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from altd.errors import BadInputError, did_you_mean
from altd.process.standard_streams import complain

_CHOICE = re.compile(r"argument (.+?): invalid choice: (.+?) \(choose from ", re.DOTALL)
_MISSING = re.compile(r"the following arguments are required: (.*)", re.DOTALL)
_NO_NUMBER = re.compile(r"argument (.+?): invalid (int|float) value: (.*)", re.DOTALL)
_NO_VALUE = re.compile(r"argument (.+?): expected (.*)", re.DOTALL)


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line that names the argument and what is possible."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        self._given: list[str] = []
        self._negative_number_matcher = re.compile(r"-\d")  # argparse's own: -2h is a value and no option

    def parse_command(self, arguments: Sequence[str] | None) -> argparse.Namespace | None:
        """The arguments of a command, its name in ``command``; None: none was named, and all were shown.

        That goes to standard error: nothing was done that was asked for, and a script whose command came out
        empty must not take it for an answer.
        """
        options: argparse.Namespace
        options, unknown = self.parse_known_args(arguments)
        if unknown:
            self._command(options.command).refuse_unknown(unknown)
        if options.command is None:
            complain(*self.format_help().splitlines())
            return None
        return options

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does; what was given is kept for ``error``."""
        self._given = [] if args is None else list(args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """End with status 2 and one line."""
        complain(str(BadInputError(self.prog, self._worded(message))))
        raise SystemExit(2)

    def _worded(self, message: str) -> str:
        if found := _CHOICE.match(message):
            name, value = found[1], found[2]
            choices = [str(choice) for choice in self._choices(name)]
            what = (
                f"there is no {name.lower()} {value}"
                if name == "COMMAND"
                else f"{name}: {value} is not possible"
            )
            slips = self._unknown_options() if name == "COMMAND" else ""
            return (
                f"{what}{slips}; possible: {', '.join(choices)}{did_you_mean(value.strip(_QUOTES), choices)}"
            )
        if found := _MISSING.match(message):
            return f"missing: {found[1]}{self._unknown_options()}; {self._one_line_usage()}"
        if found := _NO_NUMBER.match(message):
            return f"{found[1]}: {found[3]} is no {'whole number' if found[2] == 'int' else 'number'}"
        if found := _NO_VALUE.match(message):
            count = found[2].replace("argument", "value")
            return f"{found[1]}: {count} must follow; {self._one_line_usage()}"
        return message.removeprefix("argument ")

    def refuse(self, command: str, message: str) -> NoReturn:
        """End with status 2 and a line about a command's arguments."""
        self._command(command).error(message)

    def refuse_unknown(self, unknown: list[str]) -> NoReturn:
        """End with status 2 and a line about the first unknown argument."""
        first = unknown[0]
        if not first.startswith("-") or first == "-":
            self.error(f"{first!r} is an argument too many; {self._one_line_usage()}")
        options = self._options()
        slip = did_you_mean(first.partition("=")[0], options)
        self.error(f"{first}: there is no such argument; possible: {', '.join(options)}{slip}")

    def _options(self) -> list[str]:
        return [action.option_strings[-1] for action in self._actions if action.option_strings]

    def _unknown_options(self) -> str:
        """The unknown arguments, each with the known ones that it resembles."""
        known = [name for action in self._actions for name in action.option_strings]
        strange = (word.partition("=")[0] for word in self._given if word.startswith("--"))
        slips = [word for word in strange if not any(name.startswith(word) for name in known)]
        return "".join(f"; there is no {word}{did_you_mean(word, known)}" for word in slips)

    def _choices(self, name: str) -> Sequence[object]:
        for action in self._actions:
            if name in ("/".join(action.option_strings), action.metavar, action.dest) and action.choices:
                return list(action.choices)
        return ()

    def _command(self, name: str | None) -> Parser:
        for action in self._actions:
            parser = action.choices.get(name) if isinstance(action.choices, Mapping) else None
            if isinstance(parser, Parser):
                return parser
        return self

    def _one_line_usage(self) -> str:
        return " ".join(self.format_usage().split())


_QUOTES = "'\""
