"""The page and the picture of the states name every cause, and the picture is well-formed."""

from xml.etree import ElementTree as ET

from altd.reasons import Reason, Signal
from altd.status.conditions import Condition
from tools.pages.reasons import page
from tools.pages.states_picture import WIDTH_PX, picture

_SVG = "{http://www.w3.org/2000/svg}"


def test_the_picture_names_every_state_and_every_cause_once() -> None:
    root = ET.fromstring(picture())
    texts = [text.text or "" for text in root.iter(f"{_SVG}text")]
    for kind in (*Reason, *Condition):
        assert texts.count(str(kind)) == 1
    for signal in Signal:
        assert texts.count(f"{str(signal).replace('_', ' ')} ({signal.number})") == 1
    assert all(0 <= float(text.get("x", "-1")) < WIDTH_PX for text in root.iter(f"{_SVG}text"))


def test_each_cause_stands_in_the_box_of_its_signal() -> None:
    root = ET.fromstring(picture())
    frames = [rect for rect in root.iter(f"{_SVG}rect") if rect.get("stroke")]
    expected = ("failure", "check_function", "out_of_specification", "maintenance_required", "good")
    spans = [(float(rect.get("y", "0")), float(rect.get("height", "0"))) for rect in frames]
    assert spans == sorted(spans)
    boxes = dict(zip(expected, spans, strict=True))
    place = {text.text: float(text.get("y", "0")) for text in root.iter(f"{_SVG}text")}
    for kind in (*Reason, *Condition):
        top, height = boxes[str(kind.signal)]
        assert top < place[str(kind)] < top + height


def test_the_page_has_a_row_for_every_cause_with_its_remedy() -> None:
    rows = [line for line in page().splitlines() if line.startswith("| `")]
    for kind in (*Reason, *Condition):
        tail = f"| `{kind.signal}` | {kind.meaning} | {kind.remedy} |"
        assert [row for row in rows if row.startswith(f"| `{kind}` |") and row.endswith(tail)]
