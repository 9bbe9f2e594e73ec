"""Claims beyond the nodes, against a unit that this project did not make."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np

from altd.calibration.fitting import fit_nodes, outer_rows
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from hw_sim.lens import HEIGHT_PX, WIDTH_PX


def test_the_outer_rows_of_a_unit_that_this_project_did_not_make_are_where_they_are_predicted(
    unit_a: Path,
) -> None:
    """A whole pitch of 25 mm outside of the other nodes: twice what a map is ever asked for."""
    made = pickle.loads((unit_a / "result.pickle").read_bytes())
    normalised = []
    for seen in made.evidence:
        for row in outer_rows(seen.nodes_mm):
            others = np.delete(np.arange(len(seen.nodes_mm)), row.rows)
            places, px = seen.nodes_mm[others], seen.nodes_px[others]
            alone = fit_nodes(Nodes.ordinary(places, px), (WIDTH_PX, HEIGHT_PX), 0).fit.map
            mm, _, covariance = InverseMap(replace(alone, margin_mm=26.0)).to_mm(seen.nodes_px[row.rows])
            sigma_mm = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
            normalised.append((mm - seen.nodes_mm[row.rows]) / sigma_mm)
    assert 0.8 < np.sqrt(np.mean(np.square(np.concatenate(normalised)))) < 1.25
