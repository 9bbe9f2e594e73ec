import pytest

from altd.calibration.scan_nodes import NodeCache


def test_items_up_to_the_bound_are_made_once_and_the_others_each_time() -> None:
    made: list[int] = []

    def make(node: int) -> str | None:
        made.append(node)
        return None if node == 2 else f"item {node}"

    cache = NodeCache(6, make, len, kept_bytes=3 * len("item 0"))
    assert cache.nodes == [0, 1, 3, 4, 5]
    assert made == [0, 1, 2, 3, 4, 5]
    for _ in range(2):
        assert list(cache) == [f"item {node}" for node in cache.nodes]
    assert made == [0, 1, 2, 3, 4, 5, 4, 5, 4, 5]
    assert cache[3] == "item 4"


def test_a_large_item_leaves_room_for_small_ones_behind_it() -> None:
    made: list[int] = []

    def make(node: int) -> bytes:
        made.append(node)
        return bytes(100 if node == 0 else 1)

    cache = NodeCache(4, make, len, kept_bytes=3)
    assert [len(item) for item in cache] == [100, 1, 1, 1]
    assert made == [0, 1, 2, 3, 0]


def test_a_node_whose_frame_was_changed_meanwhile_is_an_error_and_no_other_node() -> None:
    frames = {0: "a", 1: "b"}
    cache = NodeCache(2, frames.get, len, kept_bytes=0)
    del frames[0]
    with pytest.raises(ValueError, match="node 0 no longer yields a spot"):
        list(cache)
