"""An Active Laser Target drawn from the optics alone: nothing of altd or of the simulator.

The window at z 0 has white dots that scatter the beam. Its camera looks at it from behind, so the picture is
mirrored; the rear plate is 280 mm behind it. Lenses are Brown's (Brown 1971). x is right and y is up as
the beam sees them, mm; slopes are tangents.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT, DISTANCE_MM, FPS = 752, 480, 280.0, 20.0
_PIXEL_MM = 0.006
_ALUMINIUM_PER_K, _GLASS_PER_K = 23e-6, 8e-6
_FULL_WELL_E, _READ_E = 10_000.0, 25.0
_BLUR_PX = 0.6
_SUBTIMES = 12
"""Instants of an exposure whose pictures are averaged: 0.8 ms at 10 ms."""
Array = np.ndarray
Light = Callable[[Array, Array, float], Array]
"""Factor or addend of the light at x, y mm at the time t s."""


def even(x: Array, _y: Array, _t_s: float) -> Array:
    return np.ones_like(x)


@dataclass(frozen=True)
class Beam:
    """A super-Gaussian beam through x, y at the window; ``radius_mm`` is where 1/e² is left."""

    x: float = 0.0
    y: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    radius_mm: tuple[float, float] = (6.0, 5.5)
    order: float = 1.3
    turn_deg: float = 20.0
    power: float = 0.7
    """Peak in parts of the full scale."""
    field_of: Callable[[Array, Array], Array] | None = None
    """Its light at (along, across) in radii, instead of the super-Gaussian: a donut, a ring, a top hat."""

    def light(self, x: Array, y: Array) -> Array:
        """The light at places from the middle of the spot, mm."""
        c, s = np.cos(np.deg2rad(self.turn_deg)), np.sin(np.deg2rad(self.turn_deg))
        along, across = (c * x + s * y) / self.radius_mm[0], (c * y - s * x) / self.radius_mm[1]
        if self.field_of is not None:
            return self.power * self.field_of(along, across)
        return self.power * np.exp(-2 * (along**2 + across**2) ** self.order)

    def moved(self, by: Sequence[float]) -> "Beam":
        dx, dy, dsx, dsy = by
        return replace(
            self, x=self.x + dx, y=self.y + dy, slope_x=self.slope_x + dsx, slope_y=self.slope_y + dsy
        )

    @property
    def truth(self) -> dict[str, float]:
        return {"x": self.x, "y": self.y, "slope_x": self.slope_x, "slope_y": self.slope_y}


@dataclass(frozen=True)
class Scene:
    """Surroundings of the beam.

    ``film`` takes light at the window, ``rear_film`` at the plate; ``twinkle`` is a factor in the beam, at mm
    from its middle; ``ambient`` is added, in parts of the full scale.
    """

    film: Light = even
    rear_film: Light = even
    twinkle: Light = even
    ambient: Light = lambda x, y, _t_s: 0.02 + 1e-4 * x + 0.5e-4 * y
    moves: Callable[[float], Sequence[float]] = lambda _t_s: (0.0, 0.0, 0.0, 0.0)
    """Motion of the beam: x, y and slopes to add at the time t s."""
    exposure_ms: float = 10.0


def patch(x_mm: float, y_mm: float, diameter_mm: float, loss: float, edge_mm: float = 1.5) -> Light:
    """A film that takes a part of the light in a disc with a soft edge."""

    def left(x: Array, y: Array, _t_s: float) -> Array:
        return 1 - loss / (1 + np.exp((np.hypot(x - x_mm, y - y_mm) - diameter_mm / 2) / (edge_mm / 2)))

    return left


def grains(seed: object, size_mm: float, contrast: float, extent_mm: float = 120.0) -> Light:
    """A factor of mean 1 and that contrast with grains of that size, the same for every ``t_s``."""
    step = size_mm / 3
    count = int(2 * extent_mm / step) + 1
    noise = np.random.default_rng(seed).normal(size=(count, count)).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), 1.2)
    noise *= contrast / noise.std()

    def factor(x: Array, y: Array, _t_s: float) -> Array:
        u, v = (((place + extent_mm) / step).astype(np.float32) for place in (x, y))
        return np.maximum(1 + cv2.remap(noise, u, v, cv2.INTER_LINEAR), 0.0)

    return factor


def scintillation(seed: object, cell_mm: float, rms: float) -> Light:
    """Light in turbulent air: log-normal, of mean 1 and that relative rms, in other cells at each ``t_s``."""
    sigma = np.sqrt(np.log1p(rms**2))
    cells: dict[float, Light] = {}

    def factor(x: Array, y: Array, t_s: float) -> Array:
        if t_s not in cells:  # both cameras see the same light
            cells.clear()
            cells[t_s] = grains([seed, round(1e6 * t_s)], cell_mm, 0.1, 30.0)
        return np.exp(sigma * 10 * (cells[t_s](x, y, t_s) - 1) - sigma**2 / 2)

    return factor


@dataclass(frozen=True)
class _Camera:
    """A camera before a plane target: ``x_mm``, ``y_mm`` the place that each pixel (or part of one) sees."""

    x_mm: Array
    y_mm: Array
    z_mm: Array
    """Distance of the place behind the untilted target, along the beam."""
    response: Array
    """Light of each pixel for even light on the target."""


def _looks(
    focal_mm: float,
    away_mm: float,
    lens: Sequence[float],
    tilt: Sequence[float],
    mirrored: bool,
    slant: float,
    parts: int,
):
    """Return the places (x, y, z) mm that ``parts`` × ``parts`` points of each pixel see.

    ``slant`` is the tangent by which the target is turned about its own vertical axis.
    """
    steps = (np.arange(parts) + 0.5) / parts - 0.5
    u, v = np.meshgrid(
        (np.arange(WIDTH)[:, None] + steps).ravel(), (np.arange(HEIGHT)[:, None] + steps).ravel()
    )
    xd, yd = (
        (u - (WIDTH - 1) / 2 - 3.0) * _PIXEL_MM / focal_mm,
        (v - (HEIGHT - 1) / 2 + 2.0) * _PIXEL_MM / focal_mm,
    )
    k1, k2, p1, p2 = lens
    x, y = xd.copy(), yd.copy()
    for _ in range(12):  # Brown's distortion has no inverse in closed form
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2 * r2
        x, y = (
            (xd - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial,
            (yd - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    turn, _ = cv2.Rodrigues(np.deg2rad(np.array([*tilt, 0.4])))
    rays = turn[:, 0, None, None] * x + turn[:, 1, None, None] * y + turn[:, 2, None, None]
    reach = away_mm / (rays[2] - slant * rays[0])
    at_x, at_y = reach * rays[0], -reach * rays[1]
    away = slant * at_x  # from the camera; the front camera looks against the beam
    return (-at_x, at_y, -away) if mirrored else (at_x, at_y, away)


def _binned(parts_of: Array, parts: int) -> Array:
    return parts_of.reshape(HEIGHT, parts, WIDTH, parts).mean(axis=(1, 3))


@dataclass(frozen=True)
class Unit:
    """A unit; ``print_mm``: the left, right, lower and upper end of the print; ``warm_k`` warms all of it.

    ``expansion_per_k`` is that of what holds each camera to its target, and of what holds the targets.
    """

    seed: int = 1
    pitch_mm: float = 1.0
    dot_mm: float = 0.5
    grain: float = 0.12
    print_mm: tuple[float, float, float, float] = (-1e3, 1e3, -1e3, 1e3)
    window_tilt_deg: float = 0.0
    warm_k: float = 0.0
    expansion_per_k: tuple[float, float] = (_ALUMINIUM_PER_K, _ALUMINIUM_PER_K)
    rear_shift_mm: tuple[float, float] = (0.0, 0.0)
    """Shift of the rear camera's view, at the plate."""
    _cameras: dict[str, _Camera] = field(default_factory=dict, repr=False, compare=False)

    def camera(self, name: str) -> _Camera:
        if name not in self._cameras:
            self._cameras[name] = self._made(name)
        return self._cameras[name]

    def _made(self, name: str) -> _Camera:
        rng = np.random.default_rng([self.seed, name == "rear"])
        lens = rng.normal((-0.12, 0.05, 0, 0), (0.02, 0.02, 8e-4, 8e-4))
        tilt = rng.normal(0, 1.2, 2)
        grown = 1 + self.expansion_per_k[0] * self.warm_k
        is_front = name == "front"
        focal_mm, away_mm = (8.0, 360.0 * grown) if is_front else (5.7, 256.0 * grown)
        slant = np.tan(np.deg2rad(self.window_tilt_deg)) if is_front else 0.0
        looks = [_looks(focal_mm, away_mm, lens, tilt, is_front, slant, parts) for parts in (1, 3)]
        shrunk = 1 + (_GLASS_PER_K if is_front else _ALUMINIUM_PER_K) * self.warm_k
        moved = (0.0, 0.0) if is_front else self.rear_shift_mm
        (x, y, z), (fine_x, fine_y, _) = [(x + moved[0], y + moved[1], z) for x, y, z in looks]
        fine_x *= np.hypot(1, slant)
        surface = grains([self.seed, is_front, 7], 0.35, self.grain)(fine_x / shrunk, fine_y / shrunk, 0.0)
        if is_front:
            surface *= self._print(fine_x / shrunk, fine_y / shrunk, rng)
        fall_off = np.cos(np.arctan(np.hypot(x, y) / away_mm)) ** 4
        seen = cv2.GaussianBlur(_binned(surface, 3), (0, 0), _BLUR_PX)
        return _Camera(x, y, z, seen * fall_off)

    def _print(self, x: Array, y: Array, rng: np.random.Generator) -> Array:
        """Share of the light that the print scatters: hexagonal dots, each a little off its place."""
        row_mm = self.pitch_mm * np.sqrt(3) / 2
        rows, columns = int(240 / row_mm), int(240 / self.pitch_mm)
        off = rng.normal(0, 0.015 * self.pitch_mm, (2, rows, columns))
        size = rng.normal(self.dot_mm / 2, 0.02 * self.dot_mm, (rows, columns))
        left, right, low, high = self.print_mm
        row = np.rint(y / row_mm).astype(int)
        odd = 0.5 * (row % 2)
        column = np.rint(x / self.pitch_mm - odd).astype(int)
        at = (row + rows // 2).clip(0, rows - 1), (column + columns // 2).clip(0, columns - 1)
        dot_x, dot_y = (column + odd) * self.pitch_mm + off[0][at], row * row_mm + off[1][at]
        is_printed = (dot_x > left) & (dot_x < right) & (dot_y > low) & (dot_y < high)
        edge = (size[at] - np.hypot(x - dot_x, y - dot_y)) / 0.04
        return 0.04 + 0.85 * is_printed / (1 + np.exp(-np.clip(edge, -40, 40)))

    def light(self, name: str, beam: Beam, scene: Scene, t_s: float) -> Array:
        """Return the expected light of an exposure that ends at ``t_s``, parts of the full scale."""
        camera = self.camera(name)
        at_mm = 0.0 if name == "front" else DISTANCE_MM * (1 + self.expansion_per_k[1] * self.warm_k)
        film = scene.film if name == "front" else scene.rear_film
        x, y = camera.x_mm, camera.y_mm
        total = np.zeros_like(x)
        times = t_s - scene.exposure_ms * 1e-3 * (np.arange(_SUBTIMES) + 0.5) / _SUBTIMES
        shifts = {tuple(scene.moves(t)) for t in times}
        instants = times if len(shifts) > 1 else times[:1]
        for t in instants:
            now = beam.moved(scene.moves(t))
            dx = x - now.x - (at_mm + camera.z_mm) * now.slope_x
            dy = y - now.y - (at_mm + camera.z_mm) * now.slope_y
            lit = np.hypot(dx, dy) < 4 * max(now.radius_mm)
            total[lit] += now.light(dx[lit], dy[lit]) * scene.twinkle(dx[lit], dy[lit], t_s).ravel()
        total = total / len(instants) * film(x, y, t_s) * camera.response
        return total + scene.ambient(x, y, t_s)

    def frame(self, name: str, beam: Beam, scene: Scene, t_s: float, rng: np.random.Generator) -> Array:
        """Return an exposure with shot and read noise, 8 bits."""
        return exposed(self.light(name, beam, scene, t_s), rng)


def exposed(light: Array, rng: np.random.Generator) -> Array:
    """Return a picture of 8 bits with shot and read noise of that light, parts of the full scale."""
    electrons = rng.poisson(np.maximum(light, 0) * _FULL_WELL_E) + rng.normal(0, _READ_E, light.shape)
    return np.clip(np.rint(electrons / _FULL_WELL_E * 255), 0, 255).astype(np.uint8)


Row = tuple[float, str, Array, tuple[float, float] | None]
"""Time, camera, picture and, in a scan, the stage's place."""


def write(
    path: Path,
    kind: str,
    rows: Iterable[Row],
    serial: str = "OPTICS-1",
    fps: float = FPS,
    exposure_ms: float | None = None,
    **more: object,
) -> Path:
    """Write an altd-recording/1 (DESIGN, section 4); frames of one time are one exposure.

    ``more`` are further keys of its header.
    """
    lines, seen = ["sequence,t_s,camera,file,leds,x_mm,y_mm"], dict[float, int]()
    for t_s, name, picture, place in rows:
        number = seen.setdefault(t_s, len(seen))
        file = Path(name, f"{number:06d}.png")
        (path / name).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path / file), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        at = ",".join(f"{mm:.6f}" for mm in place) if place else ","
        lines.append(f"{number},{t_s:.6f},{name},{file},off,{at}")
    (path / "frames.csv").write_text("\n".join(lines) + "\n")
    size = {"width": WIDTH, "height": HEIGHT, "bits": 8, "exposure_ms": exposure_ms}
    unit: Mapping[str, object] = {"serial": serial, "target_distance_mm": DISTANCE_MM}
    header = {
        "format": "altd-recording/1",
        "kind": kind,
        "fps": fps,
        "cameras": {"front": size, "rear": size},
    }
    (path / "recording.json").write_text(
        json.dumps({**header, "unit": unit, "note": "drawn from the optics", **more})
    )
    return path


def scan(unit: Unit, seed: int = 1, beam: Beam | None = None, scene: Scene | None = None) -> Iterable[Row]:
    """A grid of 6 × 5 places, 25 mm apart, that a stage carries a level beam over; 2 exposures each."""
    rng, t_s = np.random.default_rng([seed, 1]), 0.0
    for y in np.arange(-2, 3) * 25.0:
        for x in (np.arange(6) - 2.5) * 25.0:
            for _ in range(2):
                for name in ("front", "rear"):
                    at = replace(beam or Beam(), x=x, y=y)
                    yield t_s, name, unit.frame(name, at, scene or Scene(), t_s, rng), (x, y)
                t_s += 1 / FPS


def lamp_flat(unit: Unit, seed: int = 1, count: int = 24) -> Iterable[Row]:
    """Exposures of targets that a lamp lights nearly evenly."""
    rng = np.random.default_rng([seed, 2])
    for number in range(count):
        for name in ("front", "rear"):
            camera = unit.camera(name)
            lamp = 0.45 * (1 + 1e-3 * camera.x_mm - 0.5e-3 * camera.y_mm)
            yield number / FPS, name, exposed(lamp * camera.response, rng), None


def poses(
    unit: Unit,
    beams: Sequence[Beam],
    scene: Scene | Callable[[int], Scene] = Scene(),
    seed: int = 1,
    exposures: int = 2,
    delays_s: Callable[[int], float] = lambda _number: 0.0,
) -> Iterable[Row]:
    """Some exposures of each beam, 20 a second, each ``delays_s`` late; a scene for all, or one for each."""
    rng = np.random.default_rng([seed, 3])
    for number in range(len(beams) * exposures):
        t_s = number / FPS + delays_s(number)
        now = scene(number) if callable(scene) else scene
        for name in ("front", "rear"):
            yield t_s, name, unit.frame(name, beams[number // exposures], now, t_s, rng), None


def random_beams(
    count: int, seed: int = 1, reach_mm: tuple[float, float] = (50.0, 40.0), **kind: object
) -> list[Beam]:
    """Beams whose spots both lie within the reach of a scan, and whose slopes a unit accepts."""
    rng = np.random.default_rng([seed, 4])
    beams = list[Beam]()
    while len(beams) < count:
        at, slopes = rng.uniform(-1, 1, 2) * reach_mm, rng.uniform(-1, 1, 2) * (0.1, 0.2)
        if np.any(np.abs(at + DISTANCE_MM * slopes) > reach_mm):
            continue
        beams.append(replace(Beam(**kind), x=at[0], y=at[1], slope_x=slopes[0], slope_y=slopes[1]))
    return beams
