"""What waits between the threads of the cameras and the event loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from altd.acquisition.latest_frames import LatestFrames
from altd.acquisition.latest_of_each import LatestOfEach
from altd.measuring.spot_locator import Located


@dataclass(frozen=True, slots=True, eq=False)
class Buffers:
    """Frames that wait to be located, and what was located and waits for the loop; of the same cameras."""

    frames: LatestFrames
    located: LatestOfEach[Located]

    @property
    def dropped(self) -> Mapping[str, int]:
        """Frames per camera that never came to the loop, located or not."""
        of_frames = self.frames.dropped
        return {camera: dropped + of_frames[camera] for camera, dropped in self.located.dropped.items()}

    def close(self) -> None:
        """Let waiting threads go; what comes later is not kept."""
        self.frames.close()
        self.located.close()
