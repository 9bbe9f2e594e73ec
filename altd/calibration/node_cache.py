"""What is computed from a scan's frames and needed more than once, kept in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")

MAX_KEPT_BYTES = 96 << 20
"""What 2,000 ordinary nodes take, 45 kB each. Of more nodes, or larger spots, the rest is made again whenever
it is asked for, from its frame: that takes time, not memory."""


class NodeCache(Generic[Item]):
    """An item a node, where a node yields one; ``nodes`` are the numbers of those that do."""

    def __init__(
        self,
        nodes: int,
        make: Callable[[int], Item | None],
        bytes_of: Callable[[Item], int],
        kept_bytes: int = MAX_KEPT_BYTES,
    ) -> None:
        """``make`` gives the item of a node by its number, the same each time it is called."""
        self.nodes: list[int] = []
        self._make = make
        self._kept: dict[int, Item] = {}
        left = kept_bytes
        for node in range(nodes):
            item = make(node)
            if item is None:
                continue
            self.nodes.append(node)
            size = bytes_of(item)
            if size <= left:
                left -= size
                self._kept[node] = item

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, at: int) -> Item:
        """The item of the node ``nodes[at]``."""
        node = self.nodes[at]
        item = self._kept.get(node)
        if item is None:
            item = self._make(node)
        if item is None:
            raise ValueError(f"node {node} yields nothing any more: its frame was changed")
        return item

    def __iter__(self) -> Iterator[Item]:
        return (self[at] for at in range(len(self)))
