"""``make bench-overload`` counts answers, memory and polls. Its figures belong to no test."""

import re
import subprocess
import sys

from support.foreign import need_namespaces, need_program
from support.places import ROOT


def test_each_part_is_measured() -> None:
    need_program("ip", "iproute2")
    namespaces = need_namespaces("--net", "--mount")
    sizes = ["--refused", "3", "--full-disk", "6", "--connections", "3", "--settle", "3"]
    done = subprocess.run(
        [*namespaces, sys.executable, "-m", "benchmarks.overload", *sizes],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert done.stdout.count("answers: 3 of status 409") == 2, done.stdout
    assert re.search(r"[1-9]\d+ attempts to connect from 64 addresses", done.stdout)
    assert re.findall(r"(\d+) Hz, .*: \d+ of [1-9]\d* polls cut", done.stdout) == ["10", "1", "1", "1"]
