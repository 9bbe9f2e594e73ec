"""Licences as SPDX expressions: what is fulfilled, and how they are written."""

import pytest

from tools.licences.spdx import canonical, is_accepted, names


class TestExpressions:
    @pytest.mark.parametrize(
        ("expression", "fulfilled"),
        [
            ("MIT", True),
            ("mit", True),
            ("GPL-3.0-or-later", False),
            ("MIT OR GPL-3.0-only", True),
            ("GPL-3.0-only OR MIT", True),
            ("MIT AND GPL-3.0-only", False),
            ("MIT AND BSD-3-Clause", True),
            ("GPL-3.0-only AND BSD-3-Clause OR MIT", True),
            ("GPL-3.0-only AND (BSD-3-Clause OR MIT)", False),
            ("(GPL-3.0-only OR MIT) AND (MIT OR BSD-3-Clause)", True),
            ("MIT OR GPL-3.0-only AND GPL-2.0-only", True),
            ("GPL-3.0-or-later WITH GCC-exception-3.1", True),
            ("GPL-2.0-or-later WITH GCC-exception-3.1", False),
            ("MIT AND GPL-3.0-or-later WITH GCC-exception-3.1", True),
            ("", False),
            ("MIT License", False),
            ("MIT OR", False),
            ("(MIT", False),
        ],
    )
    def test_what_accepted_licences_fulfil(self, expression: str, fulfilled: bool) -> None:
        accepted = {"MIT", "BSD-3-Clause", "GPL-3.0-or-later WITH GCC-exception-3.1"}
        assert is_accepted(expression, accepted) is fulfilled

    def test_the_licences_in_one(self) -> None:
        expression = "mit AND (BSD-3-Clause OR GPL-3.0-or-later with GCC-exception-3.1)"
        assert names(expression) == {"MIT", "BSD-3-Clause", "GPL-3.0-or-later WITH GCC-exception-3.1"}
        assert canonical("BSD") is None
