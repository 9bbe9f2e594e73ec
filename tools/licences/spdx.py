"""SPDX licence expressions (ISO/IEC 5962, annex D), as far as needed to decide on acceptance."""

import re
from collections.abc import Container

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression


def canonical(text: str) -> str | None:
    """Canonical spelling of an expression; None if the text is not a valid expression."""
    try:
        return canonicalize_license_expression(text)
    except InvalidLicenseExpression:
        return None


def is_accepted(expression: str, accepted: Container[str]) -> bool:
    """Whether accepted licences fulfil it: each part of an AND, one of an OR. False if invalid."""
    spelled = canonical(expression)
    if spelled is None:
        return False
    return _any_of(re.findall(r"[()]|[^\s()]+", spelled)[::-1], accepted)


def is_own_text(expression: str) -> bool:
    """Whether it refers to a text without an SPDX name."""
    return expression.startswith("LicenseRef-")


def names(expression: str) -> set[str]:
    """Licences in an expression, each with its exception."""
    joined = canonicalize_license_expression(expression).replace(" WITH ", "_WITH_")
    words = set(re.findall(r"[^\s()]+", joined)) - {"AND", "OR"}
    return {word.replace("_WITH_", " WITH ") for word in words}


def _any_of(words: list[str], accepted: Container[str]) -> bool:
    """Evaluate the words up to a closing bracket, the next word last; AND binds tighter than OR."""
    goes_with = _all_of(words, accepted)
    while words and words[-1] == "OR":
        words.pop()
        goes_with = _all_of(words, accepted) or goes_with
    return goes_with


def _all_of(words: list[str], accepted: Container[str]) -> bool:
    goes_with = _single_licence(words, accepted)
    while words and words[-1] == "AND":
        words.pop()
        goes_with = _single_licence(words, accepted) and goes_with
    return goes_with


def _single_licence(words: list[str], accepted: Container[str]) -> bool:
    word = words.pop()
    if word == "(":
        goes_with = _any_of(words, accepted)
        words.pop()
        return goes_with
    if words and words[-1] == "WITH":
        words.pop()
        word = f"{word} WITH {words.pop()}"
    return word in accepted
