"""Calibrations that are none although each number is one and the checksum fits."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import evidence
from support.pngs import png

from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError

HUGE = png(40_000, 40_000)
Document = dict[str, Any]


def _twice(document: Document) -> None:
    document["targets"][1]["name"] = "front"


def _reversed(document: Document) -> None:
    document["targets"].reverse()


def _clockwise(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"].reverse()


def _crossed(document: Document) -> None:
    hull = document["targets"][0]["map"]["hull_mm"]
    hull[0], hull[1] = hull[1], hull[0]


def _run_round_twice(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"] *= 2


def _flat_hull(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"] = [[0.0, 0.0], [10.0, 0.0], [5.0, 0.0]]


def _pointed(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"] = [[0.0, 0.0], [10.0, 0.0], [10.0, 0.0]]


def _far_hull(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"] = [[-900.0, -900.0], [900.0, -900.0], [0.0, 900.0]]


def _long_hull(document: Document) -> None:
    document["targets"][0]["map"]["hull_mm"] *= 500


def _other_degree(document: Document) -> None:
    document["targets"][0]["map"]["degree"] = [2, 1]


def _degree_of_the_nodes(document: Document) -> None:
    of_map = document["targets"][0]["map"]
    of_map["x_axis"]["nodes"] = 2
    of_map["hull_mm"] = [[-62.5, -50.0], [-37.5, -50.0], [-37.5, 50.0]]
    of_map["degree"] = [2, 1]
    for name in ("spectrum_u_px", "spectrum_v_px"):
        of_map[name] = [[*row, 0.0] for row in of_map[name]]
    for name in ("spread_u_px", "spread_v_px"):
        of_map[name] += [of_map[name][0]] * 2


def _many_nodes(document: Document) -> None:
    document["targets"][0]["map"]["x_axis"]["nodes"] = 9999


def _no_spread(document: Document) -> None:
    for name in ("spread_u_px", "spread_v_px"):
        document["targets"][0]["map"][name] = [[] for _ in range(4)]


def _wide_spread(document: Document) -> None:
    for name in ("spread_u_px", "spread_v_px"):
        document["targets"][0]["map"][name] = [[0.01] * 10_000 for _ in range(4)]


def _elsewhere(document: Document) -> None:
    document["targets"][0]["map"]["spectrum_u_px"][0][0] += 1e5


def _folded(document: Document) -> None:
    document["targets"][0]["map"]["spectrum_u_px"][0][1] = 0.0


def _spot_of_no_order(document: Document) -> None:
    document["targets"][0]["spot"] = {
        "grain": 0.02,
        "misfit_ratio": 1.5,
        "pattern_px": 0.03,
        "noise_px": 0.02,
        "shape": {"mean": [1.8, 0.0, 0.1, 0.0], "sigma": [0.1, 0.1, 0.1, 0.1]},
    }


def _shapeless(document: Document) -> None:
    document["targets"][0]["map"]["noise_shape"] = [1.9, 0.9, 0.1]


def _nested(document: Document) -> None:
    node: list[Any] = []
    for _ in range(500):
        node = [node]
    document["recording"]["note"] = node


def _huge_flat(document: Document) -> None:
    document["targets"][0]["flat"] = {"source": "recording", "png": base64.b64encode(HUGE).decode()}


def _huge_texture(document: Document) -> None:
    png_of_huge = base64.b64encode(HUGE).decode()
    table = {"hot_px": [[1, 2]], "sometimes_hot_px": [], "texture": "scan", "png": png_of_huge}
    document["targets"][0]["fingerprint"] = table


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (_twice, "targets: two targets have the same name"),
        (_reversed, "targets: z_mm must grow from target to target"),
        (_clockwise, "targets.front.map.hull_mm: is not a counter-clockwise convex polygon"),
        (_crossed, "targets.front.map.hull_mm: is not a counter-clockwise convex polygon"),
        (_run_round_twice, "targets.front.map.hull_mm: is not a counter-clockwise convex polygon"),
        (_flat_hull, "targets.front.map.hull_mm: is not a counter-clockwise convex polygon"),
        (_pointed, "targets.front.map.hull_mm: two corners in a row are the same"),
        (_far_hull, "targets.front.map.hull_mm: reaches beyond the grid"),
        (_long_hull, "targets.front.map.hull_mm: has 2000 corners, more than 1024"),
        (_other_degree, "targets.front.map.spectrum: expected 2 × 2 × 3 numbers"),
        (_degree_of_the_nodes, "targets.front.map.degree: 2 along x, but it must be 1 to 1"),
        (_many_nodes, "targets.front.map.x_axis: has 9999 nodes, more than 256"),
        (_no_spread, "targets.front.map.spread: is empty"),
        (_wide_spread, "targets.front.map.spread: has 10000 columns, more than 512"),
        (_elsewhere, "targets.front.map: puts its hull outside of the picture"),
        (_folded, "targets.front.map: puts two places of its hull on one pixel"),
        (_spot_of_no_order, "targets.0.spot.shape.mean.3: Input should be greater than 0"),
        (_shapeless, "targets.0.map.noise_shape: is not a covariance (uu, uv, vv) with trace 2"),
        (_nested, "recording.note: Input should be a valid string"),
        (_huge_texture, "targets.front.fingerprint.png: is 40000 × 40000, expected 752 × 480"),
        (_huge_flat, "targets.front.flat.png: is 40000 × 40000, expected 752 × 480"),
    ],
)
def test_a_calibration_that_is_none_although_its_checksum_fits(
    spoil: Callable[[Document], None], why: str, tmp_path: Path
) -> None:
    path = tmp_path / "cal.json"
    save_calibration(evidence.calibration(), path)
    document = json.loads(path.read_text())
    del document["checksum"]
    spoil(document)
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"))
    document["checksum"] = "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
    path.write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=re.escape(f"cal.json: {why}")) as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)
