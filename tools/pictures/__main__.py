"""Take the pictures of docs: of the demos and their pages, of the page in tests, and of the report."""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.process.endings import run_to_end
from tools.pictures.animation import Still, animated_svg
from tools.pictures.browser import screenshot
from tools.pictures.planar import draw_planar
from tools.pictures.same import shows_the_same
from tools.pictures.terminal import Terminal, terminal

_COLUMNS, _ROWS = 84, 14
_STILL_S = 0.5
_DRAWN, _LIVE, _ANY = 0.001, 0.02, 1.0
"""Share of pixels that differ in a picture that stays. Of two drawn reports 0.0001 differ, of a changed one
0.004. Pictures of a running unit have differed in up to 0.018: name one in which only few words changed.
The page of a row, whose glass is switched, and the list of events show another moment each time: name them.
"""
_ROOT = Path(__file__).resolve().parents[2]
_TITLE = (
    "make demo: measured x, y, yaw and pitch beside the truth; the beam is blocked, the measurement is not "
    "valid, and valid again when the beam is back"
)


def main(arguments: Sequence[str] | None = None, docs: Path = _ROOT / "docs") -> int:
    """Take the pictures; raises CalledProcessError or TimeoutError if a program fails.

    A picture that is named is written. Without names, all are taken, and those that show more than other
    numbers and another moment are written.
    """
    parser = argparse.ArgumentParser(prog="python -m tools.pictures", description=__doc__)
    known = [Path(file).stem for files in _TAKEN for file in files]
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"{', '.join(known)}; default all that changed"
    )
    names = parser.parse_args(arguments).names
    if unknown := sorted({*names} - {*known}):
        raise BadInputError("NAME", f"unknown picture {unknown[0]!r}; known are {', '.join(known)}")
    for files, (take, share) in _TAKEN.items():
        wanted = [file for file in files if not names or Path(file).stem in names]
        if not wanted:
            continue
        with tempfile.TemporaryDirectory(prefix="altd-pictures-") as folder:
            take(Path(folder))
            for file in wanted:
                taken, before = Path(folder, file).read_bytes(), docs / file
                is_kept = not names and before.is_file()
                is_kept = is_kept and (share == _ANY or shows_the_same(before.read_bytes(), taken, share))
                print(f"docs/{file} {'shows the same' if is_kept else 'written'}", flush=True)
                if not is_kept:
                    before.write_bytes(taken)
    return 0


def _take_planar_page(folder: Path) -> None:
    with terminal(f"{sys.executable} -m hw_sim planar", _COLUMNS, _ROWS) as demo:
        screenshot(_address(demo), folder / "planar-page.png", 640, 900, after_s=6.0)


def _take_row_page(folder: Path) -> None:
    with terminal(f"{sys.executable} -m hw_sim chain-demo", 2 * _COLUMNS, _ROWS) as demo:
        demo.await_text("alarm_displacement", timeout_s=120.0)
        screenshot(_address(demo), folder / "chain-page.png", 900, 1300, after_s=4.0)


def _take_demo(folder: Path) -> None:
    with terminal(f"{sys.executable} -m hw_sim demo", _COLUMNS, 32) as demo:
        demo.await_text("VALID, mean of 20", timeout_s=180.0)
        stills = list(_record_demo(demo))
        (folder / "demo.svg").write_text(animated_svg(stills, _COLUMNS, _ROWS, _TITLE))
        screenshot(_address(demo), folder / "page.png", 1280, 970, after_s=6.0)
        demo.press("q")


def _address(demo: Terminal) -> str:
    demo.await_text("http://127.0.0.1", timeout_s=120.0)
    found = re.search(r"http://127\.0\.0\.1:\d+", demo.text())
    assert found is not None  # noqa: S101  just awaited
    return found[0]


def _record_demo(demo: Terminal) -> Iterator[Still]:
    """Yield screens of the demo: the beam moves, is blocked, and returns."""
    for key, seconds in (("", 5.0), ("b", 4.0), ("c", 7.0)):
        if key:
            demo.press(key)
        for _ in range(round(seconds / _STILL_S)):
            began_s = time.monotonic()
            yield Still(demo.screen()[:_ROWS], _STILL_S)
            time.sleep(max(began_s + _STILL_S - time.monotonic(), 0.0))


def _take_report(folder: Path) -> None:
    """Draw the first two sheets of the report on a simulated unit with a flat, side by side."""
    simulator, altd = [sys.executable, "-m", "hw_sim"], [sys.executable, "-m", "altd.cli"]
    scan, flat, report = folder / "scan", folder / "flat", folder / "report"
    _run([*simulator, "scan", "-o", scan, "--seed", "1"])
    _run([*simulator, "flat", "-o", flat, "--seed", "1"])
    _run([*altd, "calibrate", scan, "--flat", flat, "-o", folder / "calibration.json", "--report", report])
    _run(["pdftoppm", "-r", "70", "-l", "2", "-png", report / "calibration.pdf", folder / "sheet"])
    sheets = [np.asarray(cv2.imread(str(path))) for path in sorted(folder.glob("sheet*.png"))]
    edge = np.full((sheets[0].shape[0], 8, 3), 200, np.uint8)
    picture = np.hstack([sheets[0], edge, sheets[1]])
    cv2.imwrite(str(folder / "report.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _take_screen(folder: Path) -> None:
    """Take the page as a user sees it who has no calibration yet."""
    files = partial(SimpleHTTPRequestHandler, directory=_ROOT / "altd/publish/http/page_files")
    with ThreadingHTTPServer(("127.0.0.1", 0), files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/screen.html"
        screenshot(address, folder / "coloured.png", 760, 560, after_s=1.0)
        server.shutdown()
    grey = np.asarray(cv2.imread(str(folder / "coloured.png"), cv2.IMREAD_GRAYSCALE))
    cv2.imwrite(str(folder / "screen.png"), grey, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _take_in_test(test: str, folder: Path) -> None:
    """Take the picture that a test of the page takes where it finds ``ALTD_PICTURES``."""
    os.environ["ALTD_PICTURES"] = str(folder)
    _run([sys.executable, "-m", "pytest", "-q", _ROOT / "tests/system/publish", "-k", test])


def _run(command: Sequence[str | Path]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603


_TAKEN: dict[tuple[str, ...], tuple[Callable[[Path], None], float]] = {
    ("planar.png",): (lambda folder: draw_planar(folder / "planar.png"), _DRAWN),
    ("planar-page.png",): (_take_planar_page, _LIVE),
    ("chain-page.png",): (_take_row_page, _ANY),
    ("demo.svg", "page.png"): (_take_demo, _LIVE),
    ("screen.png",): (_take_screen, _DRAWN),
    ("report.png",): (_take_report, _DRAWN),
    ("page-fault.png",): (partial(_take_in_test, "ten_faults"), _LIVE),
    ("page-events.png",): (partial(_take_in_test, "fault_at_night"), _ANY),
    ("page-unit.png",): (partial(_take_in_test, "self_checks_so_far"), _LIVE),
}
"""Pictures, the function that takes them into a folder, and the share of pixels that may differ."""


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "tools.pictures"))
