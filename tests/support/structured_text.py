"""Runs the part of IEC 61131-3 Structured Text that the page's function block uses; no compiler can be had.

Precedence is that of table 71 of IEC 61131-3:2013. Whole numbers without sign have 32 bits and wrap.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from typing import Any

_TOKEN = re.compile(r"16#[0-9A-F]+|\d+\.\d+|\d+|:=|<>|<=|>=|\w+|[-+*()\[\],;:=<>]")
_LEVELS: tuple[dict[str, Callable[[Any, Any], Any]], ...] = (
    {"OR": operator.or_},
    {"XOR": operator.xor},
    {"AND": operator.and_},
    {"=": operator.eq, "<>": operator.ne},
    {"<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge},
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul},
)
"""From the loosest operators to the tightest."""
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "SHL": lambda value, by: value << by & 0xFFFF_FFFF,
    "SHR": operator.rshift,
    "MAX": max,
    "WORD_TO_DWORD": int,
    "DWORD_TO_UDINT": int,
    "UDINT_TO_LREAL": float,
}
_ZERO = {"BOOL": False, "LREAL": 0.0}


class FunctionBlock:
    """One instance; calling it with its inputs runs its body once."""

    def __init__(self, source: str) -> None:
        text = re.sub(r"\(\*.*?\*\)", "", source, flags=re.DOTALL)
        head, body = text.rsplit("END_VAR", 1)
        self.variables: dict[str, Any] = {}
        for names, kind in re.findall(r"^\s*([\w, ]+) : (\w+)", head, re.MULTILINE):
            for name in names.split(", "):
                self.variables[name] = _ZERO.get(kind, 0)
        self._tokens = _TOKEN.findall(body)
        assert "".join(self._tokens) == "".join(body.split()), "a sign that is not known"
        self._at = 0

    def __call__(self, **inputs: Any) -> None:
        assert inputs.keys() <= self.variables.keys()
        self.variables |= inputs
        self._at = 0
        self._statements(True)
        assert self._token() == "END_FUNCTION_BLOCK"

    def _token(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1]

    def _expect(self, *tokens: str) -> None:
        for token in tokens:
            found = self._token()
            assert found == token, f"{found} where {token} is due"

    def _statements(self, live: bool) -> None:
        while (token := self._tokens[self._at]) not in ("ELSIF", "ELSE") and not token.startswith("END_"):
            self._at += 1
            {"IF": self._if, "FOR": self._for}.get(token, lambda live, t=token: self._assign(t, live))(live)

    def _assign(self, name: str, live: bool) -> None:
        self._expect(":=")
        value = self._expression()
        self._expect(";")
        if live:
            kind = type(self.variables[name])
            assert isinstance(value, kind), f"{name} := {value!r}"
            self.variables[name] = value

    def _if(self, live: bool) -> None:
        taken, branch = False, "IF"
        while branch != "END_IF":
            if branch == "ELSE":
                holds = True
            else:
                holds = self._expression()
                assert isinstance(holds, bool)
                self._expect("THEN")
            self._statements(live and holds and not taken)
            taken |= holds
            branch = self._token()
        self._expect(";")

    def _for(self, live: bool) -> None:
        name = self._token()
        self._expect(":=")
        first = self._expression()
        self._expect("TO")
        last = self._expression()
        self._expect("DO")
        begin = self._at
        for value in range(first, last + 1):
            self._at = begin
            self.variables[name] = value
            self._statements(live)
        self._expect("END_FOR", ";")

    def _expression(self, level: int = 0) -> Any:
        if level == len(_LEVELS):
            return self._operand()
        value = self._expression(level + 1)
        while (token := self._tokens[self._at]) in _LEVELS[level]:
            self._at += 1
            other = self._expression(level + 1)
            assert type(value) is type(other), f"{value!r} {token} {other!r}"
            value = _LEVELS[level][token](value, other)
            if type(value) is int:
                value &= 0xFFFF_FFFF
        return value

    def _operand(self) -> Any:
        token = self._token()
        if token == "(":
            value = self._expression()
            self._expect(")")
            return value
        if token == "NOT":
            value = self._operand()
            return not value if isinstance(value, bool) else ~value & 0xFFFF_FFFF
        if token in ("TRUE", "FALSE"):
            return token == "TRUE"
        if token.startswith("16#"):
            return int(token[3:], 16)
        if token[0].isdigit():
            return float(token) if "." in token else int(token)
        if token in _FUNCTIONS:
            self._expect("(")
            given = [self._expression()]
            while (following := self._token()) == ",":
                given.append(self._expression())
            assert following == ")"
            return _FUNCTIONS[token](*given)
        value = self.variables[token]
        if self._tokens[self._at] == "[":
            self._at += 1
            value = value[self._expression()]
            self._expect("]")
        return value
