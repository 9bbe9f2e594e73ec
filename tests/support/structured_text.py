"""Runs the part of IEC 61131-3 Structured Text that the example uses: type check, translation to Python.

Debian, PyPI and npm have no free compiler of it. Precedence is that of table 71 of IEC 61131-3:2013.
"""

import math
import re
from collections.abc import Callable
from typing import Any

_TOKEN = re.compile(
    r"16#[0-9A-F]+|'[^']*'|\d+\.\d+(?:E\d+)?|\d+|\.\.|:=|<>|<=|>=|[A-Za-z]\w*(?:\.[a-z]\w*)?|\S"
)
_LEVELS = (("OR",), ("XOR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
"""From the loosest operators to the tightest."""
_PYTHON = {"OR": "|", "XOR": "^", "AND": "&", "=": "==", "<>": "!="}
_MASKS = {"WORD": 0xFFFF, "DWORD": 0xFFFF_FFFF, "UDINT": 0xFFFF_FFFF}
_ZERO = {"BOOL": False, "LREAL": 0.0, "STRING": ""}
_LITERALS = {"16#": ("WORD", "DWORD", "UDINT"), "1": ("INT", "UDINT")}
"""The types that a literal takes from its neighbour."""


def _element(array: list[Any], index: int) -> Any:
    assert 0 <= index < len(array)
    return array[index]


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "_element": _element,
    "SHL": lambda value, by: value << by & 0xFFFF_FFFF,
    "SHR": lambda value, by: value >> by,
    "ROL": lambda word, by: (word << by | word >> 16 - by) & 0xFFFF,
    "SEL": lambda chosen, first, second: second if chosen else first,
    "LIMIT": lambda low, value, high: max(low, min(value, high)),
    "MAX": max,
    "EXPT": lambda base, power: base**power,
    "SIN": math.sin,
    "COS": math.cos,
    "SQRT": math.sqrt,
    "CONCAT": lambda first, second: first + second,
    "WORD_TO_INT": lambda word: word - 0x1_0000 if word >= 0x8000 else word,
    "WORD_TO_DWORD": int,
    "DWORD_TO_UDINT": int,
    "UDINT_TO_LREAL": float,
}
_RESULTS = {"EXPT": "LREAL", "CONCAT": "STRING"}

Typed = tuple[str, str]
"""An expression in Python, and its type."""


class Block:
    """An instance of a function block or program: calling it with its inputs runs its body once."""

    def __init__(self, variables: dict[str, Any], body: Callable[[dict[str, Any]], None]) -> None:
        self.v, self._body = variables, body

    def __call__(self, **inputs: Any) -> None:
        assert inputs.keys() <= self.v.keys()
        self.v |= inputs
        self._body(self.v)


class Library:
    """The definitions of a source; ``new`` makes instances of its function blocks and programs."""

    def __init__(self, source: str) -> None:
        self._tokens = _TOKEN.findall(re.sub(r"\(\*.*?\*\)", "", source, flags=re.DOTALL))
        self._at = 0
        self._aliases: dict[str, str] = {}
        self._members: dict[str, dict[str, str]] = {}  # the types of each unit's variables
        self._initial: dict[str, dict[str, Any]] = {}
        self._names: dict[str, Any] = dict(_FUNCTIONS)
        self._results = dict(_RESULTS)
        while self._at < len(self._tokens):
            if self._has("TYPE"):
                name = self._token()
                self._expect(":")
                self._aliases[name] = self._type()
                self._expect(";", "END_TYPE")
            else:
                self._unit(self._token(), self._token())

    def new(self, name: str) -> Block:
        kinds = self._members[name]
        variables = {
            key: self.new(kinds[key]) if kinds[key] in self._members else value
            for key, value in self._initial[name].items()
        }
        return Block(variables, self._names[name])

    def _token(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1]

    def _has(self, *tokens: str) -> bool:
        has = self._tokens[self._at] in tokens
        self._at += has
        return has

    def _expect(self, *tokens: str) -> None:
        for token in tokens:
            found = self._token()
            assert found == token, f"{found} where {token} is due"

    def _unit(self, kind: str, name: str) -> None:
        self._types: dict[str, str] = {}
        initial: dict[str, Any] = {}
        inputs: list[str] = []
        if kind == "FUNCTION":
            self._expect(":")
            self._types[name] = self._results[name] = self._type()
        while (section := self._tokens[self._at]).startswith("VAR"):
            self._at += 1
            while not self._has("END_VAR"):
                names = [self._token()]
                while self._has(","):
                    names.append(self._token())
                self._expect(":")
                kind_of_all = self._type()
                value = self._value() if self._has(":=") else _ZERO.get(kind_of_all, 0)
                self._expect(";")
                self._types |= dict.fromkeys(names, kind_of_all)
                initial |= dict.fromkeys(names, value)
                inputs += names * (section == "VAR_INPUT")
        body = self._statements("    ")
        self._expect(f"END_{kind}")
        exec(f"def {name}(v):\n{body}", self._names)
        if kind == "FUNCTION":
            run = self._names[name]

            def function(*given: Any) -> Any:
                run(v := initial | dict(zip(inputs, given, strict=True)))
                return v[name]

            self._names[name] = function
        else:
            self._members[name], self._initial[name] = self._types, initial

    def _type(self) -> str:
        if (token := self._token()) != "ARRAY":
            return self._aliases.get(token, token)
        self._expect("[", "0", "..")
        self._token()
        self._expect("]", "OF")
        return "[]" + self._type()

    def _value(self) -> Any:
        if not self._has("["):
            return eval(self._expression()[0])
        values: list[Any] = []
        while not self._has("]"):
            value = self._value()
            if self._has("("):
                values += [self._value()] * value
                self._expect(")")
            else:
                values.append(value)
            self._has(",")
        return values

    def _statements(self, pad: str) -> str:
        text = ""
        while (token := self._tokens[self._at]) not in ("ELSIF", "ELSE") and not token.startswith("END_"):
            self._at += 1
            if token == "IF":
                text += f"{pad}if {self._as('BOOL')}:\n" + self._branch(pad)
                while self._has("ELSIF"):
                    text += f"{pad}elif {self._as('BOOL')}:\n" + self._branch(pad)
                if self._has("ELSE"):
                    text += f"{pad}else:\n{self._statements(pad + '  ')}"
                self._expect("END_IF")
            elif token == "FOR":
                name = self._token()
                self._expect(":=")
                first, _, last, _ = self._as("INT"), self._expect("TO"), self._as("INT"), self._expect("DO")
                text += f"{pad}for v['{name}'] in range({first}, {last} + 1):\n{self._statements(pad + '  ')}"
                self._expect("END_FOR")
            elif self._has("("):
                given = []
                while not self._has(")"):
                    name = self._token()
                    self._expect(":=")
                    given.append(f"{name}={self._as(self._members[self._types[token]][name])}")
                    self._has(",")
                text += f"{pad}v['{token}']({', '.join(given)})\n"
            else:
                self._expect(":=")
                text += f"{pad}v['{token}'] = {self._as(self._types[token])}\n"
            self._expect(";")
        return text or f"{pad}pass\n"

    def _branch(self, pad: str) -> str:
        self._expect("THEN")
        return self._statements(pad + "  ")

    def _as(self, kind: str) -> str:
        code, found = self._expression()
        assert _common(kind, found) == kind, f"{found} where {kind} is due: {code}"
        return code

    def _expression(self, level: int = 0) -> Typed:
        if level == len(_LEVELS):
            return self._operand()
        code, kind = self._expression(level + 1)
        while self._has(*_LEVELS[level]):
            sign = self._tokens[self._at - 1]
            other, kind_of_other = self._expression(level + 1)
            kind = _common(kind, kind_of_other)
            code = f"({code} {_PYTHON.get(sign, sign)} {other})"
            if level in (3, 4):
                kind = "BOOL"
            elif kind in _MASKS:
                code = f"({code} & {_MASKS[kind]})"
        return code, kind

    def _operand(self) -> Typed:
        token = self._token()
        if token == "(":
            code, kind = self._expression()
            self._expect(")")
            return code, kind
        if token == "NOT":
            code, kind = self._operand()
            return (f"(not {code})", kind) if kind == "BOOL" else (f"(~{code} & {_MASKS[kind]})", kind)
        if token in ("TRUE", "FALSE"):
            return token.title(), "BOOL"
        if token.startswith("16#"):
            return str(int(token[3:], 16)), "16#"
        if token[0].isdigit():
            return token, "LREAL" if "." in token else "1"
        if token.startswith("'"):
            return token, "STRING"
        if self._has("("):
            return self._call(token)
        if "." in token:
            block, name = token.split(".")
            return f"v['{block}'].v['{name}']", self._members[self._types[block]][name]
        if self._has("["):
            index = self._as("INT")
            self._expect("]")
            return f"_element(v['{token}'], {index})", self._types[token].removeprefix("[]")
        return f"v['{token}']", self._types[token]

    def _call(self, name: str) -> Typed:
        given = [self._expression()]
        while self._has(","):
            given.append(self._expression())
        self._expect(")")
        kind = self._results.get(name, given[0][1])
        if "_TO_" in name:
            source, kind = name.split("_TO_")
            assert _common(source, given[0][1]) == source, f"{name} of {given}"
        elif name in ("SEL", "MAX", "LIMIT"):
            kind = given[-1][1]
            for _, other in given[name == "SEL" :]:
                kind = _common(kind, other)
        return f"{name}({', '.join(code for code, _ in given)})", kind


def _common(one: str, other: str) -> str:
    """The type of an expression of both."""
    if one == other or other in _LITERALS.get(one, ()):
        return other
    assert one in _LITERALS.get(other, ()), f"{one} beside {other}"
    return one
