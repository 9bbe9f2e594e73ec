"""``docs/planar.png``: a simulated plate in the camera's picture, and the LEDs that altd finds."""

from pathlib import Path

import cv2
import numpy as np

from altd.instruments.planar.layout import projective_match
from altd.instruments.planar.leds import find_leds, led_image
from hw_sim.planar import Light, PlanarScene, places_mm

_SEED, _DARK = 3, 4
_BRIGHTNESS = 1.6
_FOUND, _OTHER, _AXES = (120, 230, 120), (90, 90, 250), (250, 200, 90)


def draw_planar(path: Path) -> None:
    """Write the picture: one LED is dark, and one light is a reflection."""
    scene = PlanarScene(_SEED)
    pose = scene.poses(1)[0]
    lit = [led for led in range(len(scene.leds_mm)) if led != _DARK]
    frame = scene.expose(scene.mean_electrons(pose, lit, [Light(pose[0] + 70.0, pose[1] - 20.0)]))
    discs = find_leds(led_image(frame))
    centres = np.array([(disc.u_px, disc.v_px) for disc in discs])
    numbers = {light: led for led, light in projective_match(scene.leds_mm, centres)}
    grey = np.clip(frame.astype(np.float32) * _BRIGHTNESS, 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for at, disc in enumerate(discs):
        colour = _FOUND if at in numbers else _OTHER
        middle = round(disc.u_px), round(disc.v_px)
        cv2.circle(picture, middle, 16, colour, 2, cv2.LINE_AA)
        text = f"LED {numbers[at]}" if at in numbers else "no LED"
        where = middle[0] + 20, middle[1] + 6
        cv2.putText(picture, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv2.LINE_AA)
    axes_mm = places_mm(np.array([(0.0, 0.0), (25.0, 0.0), (0.0, 25.0)]), pose)
    origin, *ends = (tuple(round(v) for v in at) for at in np.stack(scene.lens.project(*axes_mm.T), axis=-1))
    for end, name in zip(ends, "xy", strict=True):
        cv2.arrowedLine(picture, origin, end, _AXES, 2, cv2.LINE_AA)
        cv2.putText(picture, name, end, cv2.FONT_HERSHEY_SIMPLEX, 0.7, _AXES, 2, cv2.LINE_AA)
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
