"""What the cameras see, in words: for the technician who aims the beam, or looks for what is wrong."""

from __future__ import annotations

from dataclasses import replace

from altd.records import NoSpot, Spot

LEDS_LIT = "the frame LEDs are lit"
"""How the detail of a spot that was refused begins where they shine."""


def told_from_leds(refused: NoSpot, lit: int, leds: int) -> NoSpot:
    """What was refused, told from the frame LEDs where it is they that shine."""
    if lit < 2 or 2 * lit < leds:
        return refused
    return replace(refused, detail=f"{LEDS_LIT}, {lit} of {leds} shine at their places")


def in_words(spot: Spot | NoSpot) -> str:
    """What a frame shows, for the technician who aims the beam."""
    if isinstance(spot, NoSpot):
        return f"{spot.reason}, {spot.detail}" if spot.detail else str(spot.reason)
    return (
        f"spot at u {spot.u_px:.1f} v {spot.v_px:.1f} px, diameter {spot.diameter_px:.0f} px, "
        f"peak {spot.peak:.0f} counts"
    )
