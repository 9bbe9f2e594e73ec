"""One frame with what several steps need of it, each computed once, when it is first asked for."""

from __future__ import annotations

from functools import cached_property

from altd.records import Frame, NoSpot
from altd.vision.background import pixel_noise
from altd.vision.image import Noise
from altd.vision.patch import Patch, patch_around
from altd.vision.search import Region, Search, search
from altd.vision.settings import SpotSettings


class FrameAnalysis:
    """A frame, the coarse search over it, the noise of its pixels and the surroundings of its regions.

    Localiser, frame LEDs and fingerprint work on the same analysis, so that none of them searches again.
    ``found`` is the search where it has been made.
    """

    def __init__(self, frame: Frame, settings: SpotSettings, found: Search | None = None) -> None:
        self.frame = frame
        self.settings = settings
        self._found = found
        self._patches: dict[Region, Patch | NoSpot] = {}

    @property
    def found(self) -> Search:
        """The background and the bright regions."""
        if self._found is None:
            self._found = search(self.frame.pixels)
        return self._found

    @cached_property
    def noise(self) -> Noise:
        """The noise of the frame's pixels."""
        return noise_of(self.frame, self.found, self.settings)

    def patch(self, region: Region) -> Patch | NoSpot:
        """The surroundings of a bright region of this frame, or why there is no spot in it."""
        patch = self._patches.get(region)
        if patch is None:
            patch = self._patches[region] = patch_around(self.frame, region, self.found, self.settings)
        return patch

    @property
    def brightest_patch(self) -> Patch | None:
        """The surroundings of the brightest region; None where there is none, or single pixels shine."""
        patch = self.patch(self.found.regions[0]) if self.found.regions else None
        return patch if isinstance(patch, Patch) else None


def noise_of(frame: Frame, found: Search, settings: SpotSettings) -> Noise:
    """The noise of a frame's pixels."""
    read_counts = pixel_noise(frame.pixels, found.background)
    return Noise(read_counts, settings.full_well_electrons / frame.full_scale)
