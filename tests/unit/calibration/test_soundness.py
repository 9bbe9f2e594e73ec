"""Calibrations that are none although each number is one and the checksum fits."""

import base64
import hashlib
import json
import operator
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import evidence
from support.pngs import png

from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError

HUGE = base64.b64encode(png(40_000, 40_000)).decode()
Document = dict[str, Any]
Spoil = Callable[[Document, Document], object]
"""Of the document and the map of its front target."""


def _degree_of_the_nodes(document: Document, of_map: Document) -> None:
    of_map["x_axis"]["nodes"] = 2
    of_map["hull_mm"] = [[-62.5, -50.0], [-37.5, -50.0], [-37.5, 50.0]]
    of_map["degree"] = [2, 1]
    for name in ("spectrum_u_px", "spectrum_v_px"):
        of_map[name] = [[*row, 0.0] for row in of_map[name]]
    for name in ("spread_u_px", "spread_v_px"):
        of_map[name] += [of_map[name][0]] * 2


def _spot_of_no_order(document: Document, of_map: Document) -> None:
    document["targets"][0]["spot"] = {
        "grain": 0.02,
        "misfit_ratio": 1.5,
        "pattern_px": 0.03,
        "noise_px": 0.02,
        "shape": {"mean": [1.8, 0.0, 0.1, 0.0], "sigma": [0.1, 0.1, 0.1, 0.1]},
    }


def _nested(document: Document, of_map: Document) -> None:
    node: list[Any] = []
    for _ in range(500):
        node = [node]
    document["recording"]["note"] = node


def _huge_texture(document: Document, of_map: Document) -> None:
    table = {"hot_px": [[1, 2]], "sometimes_hot_px": [], "texture": "scan", "png": HUGE}
    document["targets"][0]["fingerprint"] = table


def _spread(row: list[float]) -> Spoil:
    return lambda document, of_map: of_map.update(spread_u_px=[row] * 4, spread_v_px=[row] * 4)


def _hull(*corners_mm: list[float]) -> Spoil:
    return lambda document, of_map: of_map.update(hull_mm=[*corners_mm])


NO_POLYGON = "targets.front.map.hull_mm: is not a counter-clockwise convex polygon"
SPOILT: dict[str, tuple[Spoil, str]] = {
    "twice": (lambda of, _: of["targets"][1].update(name="front"), "targets: two targets have the same name"),
    "reversed": (lambda of, _: of["targets"].reverse(), "targets: z_mm must grow from target to target"),
    "clockwise": (lambda _, of_map: of_map["hull_mm"].reverse(), NO_POLYGON),
    "crossed": (lambda _, of_map: of_map["hull_mm"].insert(0, of_map["hull_mm"].pop(1)), NO_POLYGON),
    "run round twice": (lambda _, of_map: of_map["hull_mm"].extend(of_map["hull_mm"]), NO_POLYGON),
    "flat hull": (_hull([0.0, 0.0], [10.0, 0.0], [5.0, 0.0]), NO_POLYGON),
    "pointed": (
        _hull([0.0, 0.0], [10.0, 0.0], [10.0, 0.0]),
        "targets.front.map.hull_mm: two corners in a row are the same",
    ),
    "far hull": (
        _hull([-900.0, -900.0], [900.0, -900.0], [0.0, 900.0]),
        "targets.front.map.hull_mm: reaches beyond the grid",
    ),
    "long hull": (
        lambda _, of_map: of_map.update(hull_mm=500 * of_map["hull_mm"]),
        "targets.front.map.hull_mm: has 2000 corners, more than 1024",
    ),
    "other degree": (
        lambda _, of_map: of_map.update(degree=[2, 1]),
        "targets.front.map.spectrum: expected 2 × 2 × 3 numbers",
    ),
    "degree of the nodes": (
        _degree_of_the_nodes,
        "targets.front.map.degree: 2 along x, but it must be 1 to 1",
    ),
    "many nodes": (
        lambda _, of_map: of_map["x_axis"].update(nodes=9999),
        "targets.front.map.x_axis: has 9999 nodes, more than 256",
    ),
    "no spread": (_spread([]), "targets.front.map.spread: is empty"),
    "wide spread": (_spread([0.01] * 10_000), "targets.front.map.spread: has 10000 columns, more than 512"),
    "elsewhere": (
        lambda _, of_map: operator.setitem(of_map["spectrum_u_px"][0], 0, 1e5),
        "targets.front.map: puts its hull outside of the picture",
    ),
    "folded": (
        lambda _, of_map: operator.setitem(of_map["spectrum_u_px"][0], 1, 0.0),
        "targets.front.map: puts two places of its hull on one pixel",
    ),
    "spot of no order": (_spot_of_no_order, "targets.0.spot.shape.mean.3: Input should be greater than 0"),
    "shapeless": (
        lambda _, of_map: of_map.update(noise_shape=[1.9, 0.9, 0.1]),
        "targets.0.map.noise_shape: is not a covariance (uu, uv, vv) with trace 2",
    ),
    "nested": (_nested, "recording.note: Input should be a valid string"),
    "huge texture": (_huge_texture, "targets.front.fingerprint.png: is 40000 × 40000, expected 752 × 480"),
    "huge flat": (
        lambda of, _: of["targets"][0].update(flat={"source": "recording", "png": HUGE}),
        "targets.front.flat.png: is 40000 × 40000, expected 752 × 480",
    ),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_calibration_that_is_none_although_its_checksum_fits(kind: str, tmp_path: Path) -> None:
    spoil, why = SPOILT[kind]
    path = tmp_path / "cal.json"
    save_calibration(evidence.calibration(), path)
    document = json.loads(path.read_text())
    del document["checksum"]
    spoil(document, document["targets"][0]["map"])
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"))
    document["checksum"] = "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
    path.write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=re.escape(f"cal.json: {why}")) as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)
