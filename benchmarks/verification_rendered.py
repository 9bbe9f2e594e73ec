"""``python -m benchmarks.verification_rendered DIR``: ``altd verify`` on the frames of simulated units.

Each unit is scanned, calibrated and verified with two sets of 5 × 4 nodes, the second with the unit turned;
stages and beams have errors according to the headers. Recordings, calibration and page are left in
``DIR/SEED``.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from altd.answers.verify import verify
from altd.calibration.calibrating import calibrate
from altd.calibration.file import save_calibration
from altd.calibration.report.html import html_page
from altd.calibration.report.verification import verification_page
from altd.recording.reader import open_recording
from altd.records import Limits
from benchmarks.harness import Parser, end, quiet
from benchmarks.verification import CALIBRATION_LIMITS, CHECKED, REFERENCE_LIMITS, Stage
from hw_sim.beam import BeamPose
from hw_sim.flat import record_flat
from hw_sim.recording import recording
from hw_sim.scan import LED_REFERENCE, USUAL, Grid
from hw_sim.unit import Unit, UnitConfig

EXPOSURES = 4


def scan(folder: Path, unit: Unit, stage: Stage, grid: Grid, turned: bool, limits: Limits) -> None:
    """Record a grid with this stage, the unit turned by 180° or not, and write the limits to its header."""
    rng = np.random.default_rng([unit.config.seed, turned])
    nodes = grid.nodes_mm()
    planned = len(LED_REFERENCE) + EXPOSURES * len(nodes)
    sign = -1.0 if turned else 1.0
    with recording(folder, unit, "scan", planned, quiet) as recorder:
        for leds_on in LED_REFERENCE:
            recorder.expose(BeamPose(0.0, 0.0), leds_on=leds_on)
        for node, place in zip(nodes, stage.places_mm(np.array(nodes), rng), strict=True):
            pose = BeamPose(*(sign * place).tolist(), *(sign * stage.slope).tolist())
            for _ in range(EXPOSURES):
                recorder.expose(pose, stage_mm=node)
    path = folder / "recording.json"
    header = json.loads(path.read_text())
    path.write_text(json.dumps(header | {"limits": asdict(limits), "turned_deg": 180 if turned else 0}))


def main(arguments: Sequence[str] | None = None) -> int:
    """Verify units, and print each verdict."""
    parser = Parser("benchmarks.verification_rendered", __doc__)
    parser.add_argument("folder", type=Path)
    parser.count("--units", 5, "that are verified")
    parser.add_argument("--flat", action="store_true", help="calibrate with a lamp's flat")
    options = parser.parse_args(arguments)
    for seed in range(1, options.units + 1):
        folder = options.folder / str(seed)
        unit, rng = Unit(UnitConfig(seed=seed)), np.random.default_rng([seed, 26])
        scan(folder / "scan", unit, Stage.made(CALIBRATION_LIMITS, rng), USUAL, False, CALIBRATION_LIMITS)
        flat = None
        if options.flat:
            record_flat(folder / "flat", unit, 10, quiet)
            flat = open_recording(folder / "flat")
        file = folder / "calibration.json"
        save_calibration(calibrate([open_recording(folder / "scan")], flat).calibration, file)
        reference = Stage.made(REFERENCE_LIMITS, rng)
        sets = [folder / "set-1", folder / "set-2"]
        for path in sets:
            scan(path, unit, reference, CHECKED, path is sets[1], REFERENCE_LIMITS)
        document = verify(sets, file, None, quiet)
        (folder / "verification.html").write_bytes(html_page(verification_page(document)))
        print(f"{unit.config.serial}: {document['verdict']} {document['reasons']}")
        for test in document["tests"]:
            print(f"  {test['name']:<30} {test['value']:10.5f}  limit {test['limit'] or 0.0:10.5f}")
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.verification_rendered")
