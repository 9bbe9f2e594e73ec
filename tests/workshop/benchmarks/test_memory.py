"""The memory of a command does not grow with the nodes and the frames that it works on."""

import json

import pytest
from support.cli import altd

pytestmark = pytest.mark.timeout(1200)  # minutes of work where other programs keep the cores busy

NODES, FRAMES = (20, 56), (20, 92)


@pytest.fixture(scope="module")
def peaks_mb(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[int, float]]:
    """By command and size, from a run of ``make bench-memory`` on small inputs."""
    written = tmp_path_factory.mktemp("memory") / "figures.json"
    sizes = "--nodes", ",".join(map(str, NODES)), "--frames", ",".join(map(str, FRAMES))
    options = *sizes, "--exposures", 1, "--json", written
    done = altd(*options, module="benchmarks.memory", timeout_s=1100)
    assert (done.status, done.err) == (0, "")
    figures = json.loads(written.read_text())
    assert len(done.out.splitlines()) == 1 + len(figures) == 1 + 3 * 2 + 3 * 2
    peaks: dict[str, dict[int, float]] = {}
    for figure in figures:
        assert figure["cpu_s"] > 0
        assert figure["seconds"] > 0
        peaks.setdefault(figure["command"], {})[figure["size"]] = figure["peak_mb"]
    return peaks


@pytest.mark.parametrize("command", ["altd calibrate", "altd calibrate --flat", "hw_sim scan"])
def test_a_node_more_takes_next_to_nothing(command: str, peaks_mb: dict[str, dict[int, float]]) -> None:
    """Without a flat a node took 6 MB when all of a print's pixels were in one matrix."""
    few, many = (peaks_mb[command][nodes] for nodes in NODES)
    assert (many - few) / (NODES[1] - NODES[0]) < 0.3
    assert many < 250


@pytest.mark.parametrize("command", ["altd replay", "altd record, played at full speed", "hw_sim measure"])
def test_a_frame_more_takes_nothing(command: str, peaks_mb: dict[str, dict[int, float]]) -> None:
    """A frame that were kept would be 0.36 MB. Some are, until a window is full."""
    few, many = (peaks_mb[command][frames] for frames in FRAMES)
    assert (many - few) / (FRAMES[1] - FRAMES[0]) < 0.1
    assert many < 250
