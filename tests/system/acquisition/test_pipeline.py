"""The pipeline for an hour of the injected clock."""

from support.clock import settle, stop
from support.pipeline_bench import Bench


async def test_an_hour_of_exposures_passes_without_a_loss() -> None:
    bench = Bench()
    for number in range(72_000):
        bench.put("front", "rear", sequence=number)
        await bench.clock.advance(0.05)
    await settle()
    assert bench.board.published == bench.progress == 72_000
    assert bench.component.counters["valid"] == 72_000
    assert (bench.component.counters["dropped_front"], bench.component.counters["dropped_rear"]) == (0, 0)
    await stop(bench.task)
