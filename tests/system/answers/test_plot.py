"""The drawing as an XML parser sees it; what it looks like was looked at."""

import json
import xml.etree.ElementTree as Xml
from pathlib import Path

import pytest
from support.cli import altd_here
from support.played_unit import PlayedUnit
from support.recordings import Shot, write

SVG = "{http://www.w3.org/2000/svg}"
QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def drawn(path: Path) -> dict[str, list[Xml.Element]]:
    """The groups that have a name, by their names."""
    root = Xml.parse(path).getroot()
    assert root.tag == f"{SVG}svg"
    groups: dict[str, list[Xml.Element]] = {}
    for group in root.iter(f"{SVG}g"):
        if " " in (name := group.get("id", "")):
            groups.setdefault(name, []).append(group)
    return groups


def bars_px(groups: list[Xml.Element]) -> list[tuple[float, float]]:
    """From where to where the bars of a lane's row reach."""
    spans = []
    for path in (path for group in groups for path in group.iter(f"{SVG}path")):
        fields = path.get("d", "").replace("M", " ").replace("L", " ").replace("z", " ").split()
        spans.append((min(map(float, fields[::2])), max(map(float, fields[::2]))))
    return spans


@pytest.fixture(scope="module")
def groups(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Xml.Element]]:
    """Six exposures with a beam, six without one at the rear, six with; windows of three, back to back."""
    folder = tmp_path_factory.mktemp("plot")
    beam: Shot = ((10.0, 5.0), (15.6, -3.4), None)
    path = write(folder / "rec", "measurement", [beam] * 6 + [(beam[0], None, None)] * 6 + [beam] * 6)
    header = json.loads((path / "recording.json").read_text())
    header["cameras"]["rear"]["origin"] = "simulated"
    header["note"] = "a $ and a <b>"
    (path / "recording.json").write_text(json.dumps(header))
    arguments = ("--calibration", played_unit.calibration, "--window", 3, "--every", 3)
    outcome = altd_here("replay", path, *arguments, "--plot", folder / "p.svg")
    assert (outcome.status, outcome.err) == (0, "")
    assert [line["valid"] for line in outcome.objects] == [True, True, False, False, True, True]
    return drawn(folder / "p.svg")


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_values_have_a_band_and_a_gap(groups: dict[str, list[Xml.Element]], quantity: str) -> None:
    assert len(groups[f"values of {quantity}"]) == 2
    assert len(groups[f"sigma of {quantity}"]) == 2


def test_the_lane_names_the_reasons(groups: dict[str, list[Xml.Element]]) -> None:
    assert {name for name in groups if name.startswith("status ")} == {
        *("status valid", "status rear_spot_missing", "status simulated")
    }
    (first, second), (missing,) = bars_px(groups["status valid"]), bars_px(groups["status rear_spot_missing"])
    assert first[0] < first[1] == pytest.approx(missing[0], abs=1e-3)
    assert missing[0] < missing[1] == pytest.approx(second[0], abs=1e-3)
    ((start, end),) = bars_px(groups["status simulated"])
    assert (start, end) == pytest.approx((first[0], second[1]), abs=1e-3)


def test_a_scan_shows_how_far_it_is_off(played_unit: PlayedUnit, tmp_path: Path) -> None:
    shots: list[Shot] = [((x, 0.0), (x, 0.0), (x, 0.0)) for x in (-25.0, 0.0, 25.0) for _ in range(2)]
    path = write(tmp_path / "rec", "scan", shots)
    assert (
        altd_here(
            "replay", path, "--calibration", played_unit.calibration, "--plot", tmp_path / "p.svg"
        ).status
        == 0
    )
    assert {"values of dx_mm", "values of dy_mm", "sigma of dx_mm"} <= drawn(tmp_path / "p.svg").keys()


def test_the_same_is_drawn_the_same(played_unit: PlayedUnit, tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        altd_here(
            "replay", played_unit.beams, "--calibration", played_unit.calibration, "--plot", tmp_path / name
        )
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
