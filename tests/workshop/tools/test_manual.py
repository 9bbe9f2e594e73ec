"""The manual page before groff, and the completion in a real bash."""

import shlex
import subprocess
from datetime import UTC, datetime

import pytest
from support.foreign import need_program

from altd.cli.main import COMMANDS
from tools.manual import completion, man_page


def test_groff_has_nothing_to_say_about_the_page() -> None:
    page = man_page(datetime(2026, 11, 26, tzinfo=UTC))
    shown = subprocess.run(
        [need_program("groff"), "-man", "-ww", "-Tutf8", "-P-cbou", "-rLL=1000n"],
        input=page,
        capture_output=True,
        text=True,
        check=True,
    )
    assert shown.stderr == ""
    assert all(f"altd {name}\n" in shown.stdout for name in COMMANDS)
    assert "--trace-frames" in shown.stdout


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["sel"], ["selfcheck"]),
        (["status", "--j"], ["--json"]),
        (["export", "--every", "m"], ["measurement", "minute"]),
        (["lamps", "t"], ["test"]),
        (["replay", "record"], []),  # a file
    ],
)
def test_bash_offers(typed: list[str], offered: list[str]) -> None:
    words = shlex.join(["altd", *typed])
    call = f"COMP_WORDS=({words}) COMP_CWORD={len(typed)}; _altd"
    line = f"{completion()}\n{call}; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert done.stdout.split() == offered
