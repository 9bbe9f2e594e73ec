"""Distances of a point of the machine from the beam, with uncertainty; docs/machine.md has the formulas.
python3 machine_point.py < docs/machine-vectors.json
"""

import json
import sys
from math import cos, hypot, radians, sin, sqrt

STEPS = (1e-3, 1e-3, 1e-3, 1e-3, 1e-4)


def distances(at, inclination, lever):
    """To the right and up, mm; at: x, y (mm), yaw, pitch (mm/m), roll (rad); inclination: mm/m; lever: mm."""
    x, y, yaw, pitch, roll = at
    sx, sy = yaw / 1000, pitch / 1000
    length = sqrt(1 + sx * sx + sy * sy)
    ox, oy = lever[0] - x - sx * lever[2], lever[1] - y - sy * lever[2]  # from the beam to the point
    along = (ox * sx + oy * sy) / length**2
    rx, ry, rz = ox - along * sx, oy - along * sy, -along  # perpendicular to the beam
    ux, uy, uz = -sin(roll), cos(roll), 0.0  # the vertical
    rise = length * inclination / hypot(1000, inclination)
    for _ in range(4):
        uz = rise * hypot(1, uz) - ux * sx - uy * sy
    hx, hy, hz = uy - uz * sy, uz * sx - ux, ux * sy - uy * sx  # horizontal and perpendicular to the beam
    size = sqrt(hx * hx + hy * hy + hz * hz)
    vx, vy, vz = sy * hz - hy, hx - sx * hz, sx * hy - sy * hx
    return (rx * hx + ry * hy + rz * hz) / size, (rx * vx + ry * vy + rz * vz) / (size * length)


def point(beam, covariance, roll, inclination, lever, sigma_lever):
    """Return right, up and their standard uncertainties, mm; roll: with its uncertainty, degrees."""
    roll_deg, sigma_roll_deg = roll
    at = (*beam, radians(roll_deg))
    found = distances(at, inclination, lever)
    slopes = []
    for place, step in enumerate(STEPS):
        more, less = ((*at[:place], at[place] + sign * step, *at[place + 1 :]) for sign in (1, -1))
        pair = zip(distances(more, inclination, lever), distances(less, inclination, lever), strict=True)
        slopes.append([(one - other) / (2 * step) for one, other in pair])
    sigmas = []
    for axis in (0, 1):
        by = [slope[axis] for slope in slopes]
        variance = (by[4] * radians(sigma_roll_deg)) ** 2 + sigma_lever**2
        for row in range(4):
            for column in range(4):
                variance += by[row] * covariance[row][column] * by[column]
        sigmas.append(sqrt(variance))
    return (*found, *sigmas)


if __name__ == "__main__":
    for case in json.load(sys.stdin):
        beam, covariance, roll, sigma_roll, *rest = case["given"].values()
        print(*(f"{number:.4f}" for number in point(beam, covariance, (roll, sigma_roll), *rest)))
