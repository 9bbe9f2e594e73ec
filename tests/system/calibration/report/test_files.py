"""The two files as a person gets them, read by parsers and programs that know nothing of altd."""

import base64
import re
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from support.evidence import calibration, evidence, target
from support.foreign import need_program
from support.recordings import header

from altd.calibration.report.content import report_on
from altd.calibration.report.document import Document, Heading, Row, Table
from altd.calibration.report.html import html_page
from altd.calibration.report.sheets import pdf_sheets
from altd.calibration.report.write import Source
from altd.recording.header import RecordingHeader

SIZE = {"width": 752, "height": 480, "bits": 8}
CAMERA = {"model": "acA <1>", "serial": "50-7", "driver": "aravis", "exposure_ms": 2.5, "gain_db": 6.0}
HEADER = RecordingHeader.model_validate(
    header("scan", made_by="altd 9.9", cameras={"front": {**SIZE, **CAMERA}, "rear": SIZE})
)

VOID = {"meta", "img", "col", "br"}


class Page(HTMLParser):
    """Text, tags and attributes of a page whose tags must close in the order in which they opened."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(f"{tag}.{name}", value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += f" {data}"

    def all(self, attribute: str) -> list[str]:
        return [value for name, value in self.attributes if name == attribute]


@pytest.fixture(scope="module")
def document() -> Document:
    excluded = (((62.5, 50.0), "its spot lies 7.1 px from where the other nodes put it"),)
    front = replace(evidence("front"), excluded=excluded)
    rear = evidence("rear", seed=2)
    single = rear.scatter_px.copy()
    single[3] = np.nan
    rear = replace(rear, scatter_px=single)
    negative = np.linspace(0, 255, 120 * 188).reshape(120, 188).astype(np.uint8)
    return report_on(
        Source(calibration(), (front, rear), {"front": negative}, "altd calibrate <scan> -o c", (HEADER,))
    )


@pytest.fixture(scope="module")
def page(document: Document) -> bytes:
    return html_page(document)


@pytest.fixture(scope="module")
def sheets(document: Document, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "calibration.pdf"
    path.write_bytes(pdf_sheets(document, calibration().created))
    return path


def svgs(page: bytes) -> Iterator[ElementTree.Element]:
    for source in Page(page.decode()).all("img.src"):
        kind, data = source.split(",", 1)
        assert kind == "data:image/svg+xml;base64"
        yield ElementTree.fromstring(base64.b64decode(data, validate=True))


def test_the_page_needs_nothing_from_outside(page: bytes) -> None:
    text = page.decode()
    assert not re.search(r"(?:https?|file|ftp):|//[a-z]|@import|@font-face|<script|<link|<iframe|url\(", text)
    assert "script" not in Page(text).tags
    for svg in svgs(page):
        for element in svg.iter():
            assert not element.tag.endswith("}script")
            for name, value in element.attrib.items():
                if name.endswith("href"):
                    assert value.startswith(("#", "data:image/png;base64,"))


def test_every_picture_says_what_it_shows_and_keeps_its_shape(page: bytes) -> None:
    parsed = Page(page.decode())
    words = parsed.all("img.alt")
    assert len(words) == len(set(words)) == len(list(svgs(page))) == 20
    assert all(words)
    for svg, width, height in zip(svgs(page), parsed.all("img.width"), parsed.all("img.height"), strict=True):
        _, _, across, down = map(float, svg.attrib["viewBox"].split())
        assert across / down == pytest.approx(int(width) / int(height), rel=0.01)


def expected_numbers() -> list[str]:
    made = calibration()
    return [
        "Calibration of unit TEST-1",
        "made up <by> a test & 5 $",
        made.recording_sha256,
        "2026-11-20T08:15:30.000Z",
        "altd calibrate <scan> -o c",
        "0.0099 / 0.0054 / 0.0234",
        "0.0378 / 0.0400 / 0.0144",
        "90.25, 60.50",
        "its spot lies 7.1 px from where the other nodes put it",
        "front 0.05, rear 0.05 px",
        f"numpy {np.__version__}",
    ]


@pytest.mark.parametrize("expected", expected_numbers())
def test_the_page_has_the_numbers_of_the_calibration(expected: str, page: bytes) -> None:
    assert expected in Page(page.decode()).text


def test_the_verdict_comes_first(page: bytes) -> None:
    text = " ".join(Page(page.decode()).text.split())
    said = text.index("Not decided: positioning of the stage, scale of the stage, ")
    assert said < text.index("Criteria")
    assert "Shares of the variance: the fixed pattern of print and speckle 8" in text


def test_a_foreign_reader_opens_the_pdf_and_finds_the_same(document: Document, sheets: Path) -> None:
    read = [need_program("pdftotext", "poppler-utils"), "-layout", str(sheets), "-"]
    done = subprocess.run(read, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    text = " ".join(done.stdout.replace(" / ", "/").split())
    for expected in expected_numbers():
        assert all(word in text for word in expected.replace(" / ", "/").split())
    for block in document.blocks:
        if isinstance(block, Heading):
            assert block.text in text
        elif isinstance(block, Row):
            assert all(word in text for word in block.caption.replace(" / ", "/").split())
        elif isinstance(block, Table):
            for row in block.rows:
                assert all(word in text for cell in row for word in cell.replace(" / ", "/").split())
    pages = done.stdout.count("\f")
    assert f"{pages}/{pages}" in text


def test_nothing_leaves_the_sheets(sheets: Path, tmp_path: Path) -> None:
    """The margins of all sheets are white."""
    ppm = need_program("pdftoppm", "poppler-utils")
    subprocess.run([ppm, "-r", "30", "-gray", sheets, tmp_path / "sheet"], check=True)
    import cv2

    images = sorted(tmp_path.glob("sheet*.pgm"))
    assert len(images) >= 4
    for path in images:
        grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert grey is not None
        for margin in (grey[:10], grey[-8:], grey[:, :12], grey[:, -12:]):
            assert margin.min() > 240, path.name


def test_pictures_of_a_third_target_have_room_of_their_own(tmp_path: Path) -> None:
    middle = replace(target("rear"), name="middle", z_mm=140.0, width=480, height=752)
    made = calibration(target("front"), middle, target("rear"))
    seen = tuple(evidence(name) for name in made.target_names)
    whole = report_on(Source(made, seen, {}, "altd", (HEADER,)))
    residuals = next(b for b in whole.blocks if isinstance(b, Row) and len(b.pictures) == 3)
    path = tmp_path / "three.pdf"
    path.write_bytes(pdf_sheets(replace(whole, blocks=(residuals,)), made.created))
    reader = need_program("pdftotext", "poppler-utils")
    done = subprocess.run([reader, "-bbox", path, "-"], capture_output=True, text=True, check=True)
    places = {
        word: (float(x), float(y))
        for x, y, word in re.findall(r'xMin="([\d.]+)" yMin="([\d.]+)".*>(front|middle|rear)<', done.stdout)
    }
    assert places["front"][1] == pytest.approx(places["middle"][1])
    assert places["rear"][0] == pytest.approx(places["front"][0])
    assert places["rear"][1] > places["front"][1] + 150  # a picture's height, in points


def test_a_report_comes_out_the_same_again(document: Document) -> None:
    few = replace(document, blocks=tuple(b for b in document.blocks if not isinstance(b, Row))[:6])
    rows = [block for block in document.blocks if isinstance(block, Row)]
    few = replace(few, blocks=(*few.blocks, rows[1], rows[3]))
    created = calibration().created
    assert html_page(few) == html_page(few)
    assert pdf_sheets(few, created) == pdf_sheets(few, created)


def test_a_note_in_any_language_is_no_obstacle() -> None:
    made = replace(calibration(target("front"), target("rear")), recording_note="试验 " * 40)
    whole = report_on(Source(made, (evidence("front"), evidence("rear")), {}, "altd", (HEADER,)))
    few = replace(whole, blocks=whole.blocks[-2:])
    assert "试验" in html_page(few).decode()
    assert pdf_sheets(few, made.created).startswith(b"%PDF")


def test_the_inputs_name_cameras_exposure_gain_and_program(page: bytes) -> None:
    text = " ".join(Page(page.decode()).text.split())
    assert "Recorded by altd 9.9" in text
    of_front = "acA <1>, serial 50-7, driver aravis, exposure 2.5 ms, gain 6 dB; frames: camera"
    assert f"Camera front {of_front}" in text
    assert "Camera rear serial, exposure and gain not known; frames: camera" in text
    assert "Tilt of the calibrating beam the unit was not scanned turned by 180°" in text
