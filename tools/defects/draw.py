"""Draws defects: mutations of one node of a module's syntax tree, chosen by a seed.

mutmut changes bodies of functions only, no constant of a module, and cosmic-ray tries all mutations of a
package, in the work tree itself; mutatest is no longer maintained. None of them draws evenly over rooms.

A choice depends on a hash of the seed and of the node's own text and function, so that a change of one module
changes the draw from this module only.
"""

import ast
import hashlib
import textwrap
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tools.defects.defect import Defect, room_of

_COMPARISONS = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
_ORDER = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_OPPOSITES = {"min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "sin": "cos", "cos": "sin"}
_TEXTS = {"log", "logging", "say", "complain", "print"}
"""Names whose calls only write text for people."""
_NOT_MUTATED = {"annotation", "returns", "decorator_list", "type_params", "bases"}
_EXITS = (ast.Return, ast.Raise, ast.Continue, ast.Break)


@dataclass(frozen=True, slots=True)
class _Mutation:
    """New text of a node; ``kind`` groups mutations so that frequent ones do not crowd out the others."""

    kind: str
    node: ast.AST
    new: str


def drawn(root: Path, number: int, seed: int, modules: int = 0) -> list[Defect]:
    """Draw defects in ``root/altd``, as evenly over its rooms as their numbers of files allow.

    With fewer defects than rooms, rooms are drawn too; with ``modules``, defects are spread evenly over as
    many modules instead. The same seed gives the same defects.
    """
    rooms: dict[str, list[str]] = {}
    files = sorted(str(path.relative_to(root)) for path in root.glob("altd/**/*.py"))
    for file in sorted(files, key=lambda name: _rank(seed, name)):
        if modules and len(rooms) == modules:
            break
        if not modules or _shuffled(root, file, seed):
            rooms.setdefault(file if modules else room_of(file), []).append(file)
    taken: Counter[str] = Counter()
    defects: list[Defect] = []
    while len(defects) < number and rooms:
        room = max(rooms, key=lambda name: len(rooms[name]) / (taken[name] or 1e-6))
        turn, module = divmod(taken[room], len(rooms[room]))
        found = _shuffled(root, rooms[room][module], seed)
        if turn < len(found):
            defects.append(found[turn])
            taken[room] += 1
        else:
            del rooms[room][module]
            if not rooms[room]:
                del rooms[room]
    return sorted(defects, key=lambda defect: defect.file)


@cache
def _shuffled(root: Path, file: str, seed: int) -> list[Defect]:
    """Return all defects of a module in the order of the draw: first one of each kind."""
    of_kind: Counter[str] = Counter()
    turns = {}
    defects = defects_of(file, (root / file).read_text(encoding="utf-8"))
    for kind, defect in sorted(defects, key=lambda pair: _rank(seed, pair[1].what)):
        turns[defect] = (of_kind[kind], _rank(seed, file, kind))
        of_kind[kind] += 1
    return sorted(turns, key=turns.__getitem__)


def defects_of(file: str, text: str) -> list[tuple[str, Defect]]:
    """Return every mutation of a module with its kind; each gives valid Python."""
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def at(line: int, column_bytes: int) -> int:
        return starts[line - 1] + len(lines[line - 1].encode()[:column_bytes].decode())

    seen: Counter[str] = Counter()
    found = []
    for scope, mutation in _mutations(ast.parse(text), ""):
        node = mutation.node
        assert isinstance(node, ast.expr | ast.stmt)  # noqa: S101  the others have no place
        begin = at(node.lineno, node.col_offset)
        old = text[begin : at(node.end_lineno or 0, node.end_col_offset or 0)]
        what = f"{file}{scope and f', {scope[1:]}'}: `{_short(old)}` becomes `{_short(mutation.new)}`"
        seen[what] += 1
        numbered = what if seen[what] == 1 else f"{what} ({seen[what]})"
        found.append((mutation.kind, Defect(numbered, file, old, mutation.new, begin)))
    return found


def _short(source: str) -> str:
    return textwrap.shorten(source, 90, placeholder=" …")


def _rank(seed: int, *words: str) -> str:
    return hashlib.sha256("\0".join([str(seed), *words]).encode()).hexdigest()


def _mutations(node: ast.AST, scope: str) -> Iterator[tuple[str, _Mutation]]:
    """Yield the mutations of a node and of those within it, with the function that they are in."""
    if _is_left_out(node):
        return
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        scope = f"{scope}.{node.name}"
    for mutation in (*_of_value(node), *_of_action(node)):
        yield scope, mutation
    for name, value in ast.iter_fields(node):
        if name not in _NOT_MUTATED:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _mutations(child, scope)


def _is_left_out(node: ast.AST) -> bool:
    """Return whether a node holds texts, types or declarations alone: a defect there changes no result."""
    match node:
        case ast.JoinedStr() | ast.Raise() | ast.Assert() | ast.Import() | ast.ImportFrom():
            return True
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(value=ast.Name(id=name))):
            return name in _TEXTS or name == "isinstance"
        case ast.ClassDef(bases=bases):
            return any("Protocol" in ast.unparse(base) for base in bases)
        case ast.FunctionDef(decorator_list=marks):
            return any(ast.unparse(mark) in {"overload", "abstractmethod"} for mark in marks)
        case ast.If(test=test):
            return "TYPE_CHECKING" in ast.unparse(test) or "__main__" in ast.unparse(test)
        case ast.keyword(arg=name):
            return name == "strict"
        case ast.Subscript(value=ast.Name(id=name)):
            return name == "Literal"
    return False


def _of_value(node: ast.AST) -> Iterator[_Mutation]:
    match node:
        case ast.Constant(value=bool() as value):
            yield _Mutation("boolean", node, str(not value))
        case ast.Constant(value=int() as value):
            yield _Mutation("off by one", node, str(value + 1))
        case ast.Constant(value=float() as value):
            yield _Mutation("constant", node, repr(value * 2 or 1.0))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield _Mutation("sign", node, _source(operand))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield _Mutation("condition", node, _source(operand))
        case ast.BinOp():
            yield from _of_arithmetic(node)
        case ast.BoolOp(op=op, values=values):
            other = " or " if isinstance(op, ast.And) else " and "
            yield _Mutation("condition", node, f"({other.join(map(_source, values))})")
            yield _Mutation("dropped condition", node, _source(values[0]))
            yield _Mutation("dropped condition", node, _source(values[-1]))
        case ast.Compare():
            yield from _of_comparison(node)


def _of_action(node: ast.AST) -> Iterator[_Mutation]:
    match node:
        case ast.Call(func=ast.Name(id=name)) if name in _OPPOSITES:
            yield _Mutation("opposite", node.func, _OPPOSITES[name])
        case ast.Call(func=ast.Attribute(value=of, attr=name)) if name in _OPPOSITES:
            yield _Mutation("opposite", node.func, f"{_source(of)}.{_OPPOSITES[name]}")
        case ast.Call(args=[ast.Name() | ast.Attribute() as one, ast.Name() | ast.Attribute() as two, *rest]):
            arguments = [_source(each) for each in (two, one, *rest)]
            arguments += [ast.unparse(keyword) for keyword in node.keywords]
            yield _Mutation("swapped", node, f"{_source(node.func)}({', '.join(arguments)})")
        case ast.AugAssign(op=ast.Add() | ast.Sub()):
            yield _Mutation("term", node, f"{ast.unparse(node.target)} = {ast.unparse(node.value)}")
        case ast.Expr(value=ast.Call(func=function)) if not _is_left_out(node.value):
            if "super()" not in ast.unparse(function):
                yield _Mutation("dropped call", node, "pass")
        case ast.If(test=test, body=[only], orelse=[]) if isinstance(only, _EXITS):
            if not any(isinstance(part, ast.NamedExpr) for part in ast.walk(test)):
                yield _Mutation("guard", test, "False")


def _of_arithmetic(node: ast.BinOp) -> Iterator[_Mutation]:
    if any(
        isinstance(part, ast.JoinedStr | ast.List | ast.Tuple) or _is_text(part) for part in ast.walk(node)
    ):
        return
    left, right = _source(node.left), _source(node.right)
    match node.op:
        case ast.Add():
            yield _Mutation("term", node, left)
            yield _Mutation("sign", node, f"({left} - {right})")
        case ast.Sub():
            yield _Mutation("term", node, left)
            yield _Mutation("sign", node, f"({left} + {right})")
        case ast.Mult():
            yield _Mutation("factor", node, left)
            yield _Mutation("factor", node, right)
        case ast.Div():
            yield _Mutation("factor", node, left)
        case ast.Pow():
            yield _Mutation("factor", node, left)


def _of_comparison(node: ast.Compare) -> Iterator[_Mutation]:
    if len(node.ops) > 1:
        return
    left, right, op = _source(node.left), _source(node.comparators[0]), node.ops[0]
    sign, opposite = _COMPARISONS[type(op)]
    yield _Mutation("comparison", node, f"({left} {opposite} {right})")
    if isinstance(op, _ORDER) and right != "0":
        yield _Mutation("limit", node, f"({left} {sign} 2 * {right})")
        if "len(" in left + right or right.isdigit():
            edge = sign.removesuffix("=") if "=" in sign else f"{sign}="
            yield _Mutation("off by one", node, f"({left} {edge} {right})")


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)


def _source(node: ast.expr) -> str:
    """Return a node's source, in parentheses unless it binds tighter than any operator."""
    is_tight = isinstance(node, ast.Name | ast.Attribute | ast.Call | ast.Subscript | ast.Constant)
    return ast.unparse(node) if is_tight else f"({ast.unparse(node)})"
