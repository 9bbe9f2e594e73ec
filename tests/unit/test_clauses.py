"""The table of clauses: each has a test that exists, or a reason; none is quoted at length."""

import ast
import functools
import re
import tomllib

from support.places import ROOT

TESTS = ROOT / "tests"
TABLE = tomllib.loads((TESTS / "clauses.toml").read_text())


@functools.cache
def functions(file: str) -> set[str]:
    tree = ast.parse((TESTS / file).read_text())
    return {each.name for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_each_clause_has_a_test_that_exists_or_a_reason() -> None:
    wrong = []
    for interface, about in TABLE.items():
        numbers = [clause for clause, _, _ in about["clauses"]]
        assert about["specification"]
        assert len(set(numbers)) == len(numbers), interface
        for clause, demand, proof in about["clauses"]:
            file, _, name = proof.partition("::")
            has_reason = re.fullmatch(r"not (ours|met): .{10,}", proof) is not None
            has_test = name and (TESTS / file).is_file() and name in functions(file)
            if not (has_reason or has_test) or len(demand.split()) > 12:
                wrong.append((interface, clause, proof))
    assert wrong == []
