/* Distances of a point of the machine from the beam, with uncertainty; docs/machine.md has the formulas.
   cc -O2 -o machine_point machine_point.c -lm
   It reads lines of 27 numbers: x, y (mm), yaw, pitch (mm/m), 16 of the covariance, roll, its sigma (degrees),
   inclination of the beam (mm/m), lever x, y, z, its sigma (mm). It prints right, up, their sigmas (mm). */
#include <math.h>
#include <stdio.h>

static const double DEGREE = 0.017453292519943295;

/* at: x, y (mm), yaw, pitch (mm/m), roll (rad); found: to the right, up (mm) */
static void distances(const double at[5], double inclination, const double lever[3], double found[2]) {
    double sx = at[2] / 1000, sy = at[3] / 1000, length = sqrt(1 + sx * sx + sy * sy);
    double ox = lever[0] - at[0] - sx * lever[2], oy = lever[1] - at[1] - sy * lever[2];
    double along = (ox * sx + oy * sy) / (length * length);
    double rx = ox - along * sx, ry = oy - along * sy, rz = -along; /* perpendicular to the beam */
    double ux = -sin(at[4]), uy = cos(at[4]), uz = 0;               /* the vertical */
    double rise = length * inclination / hypot(1000, inclination);
    for (int step = 0; step < 4; step++) uz = rise * hypot(1, uz) - ux * sx - uy * sy;
    double hx = uy - uz * sy, hy = uz * sx - ux, hz = ux * sy - uy * sx; /* horizontal, perpendicular to the beam */
    double size = sqrt(hx * hx + hy * hy + hz * hz);
    double vx = sy * hz - hy, vy = hx - sx * hz, vz = sx * hy - sy * hx;
    found[0] = (rx * hx + ry * hy + rz * hz) / size;
    found[1] = (rx * vx + ry * vy + rz * vz) / (size * length);
}

/* n: the numbers of a line; result: right, up, sigma of right, sigma of up (mm) */
static void point(const double n[27], double result[4]) {
    const double steps[5] = {1e-3, 1e-3, 1e-3, 1e-3, 1e-4}, *covariance = n + 4, *lever = n + 23;
    double at[5] = {n[0], n[1], n[2], n[3], n[20] * DEGREE}, by[2][5], more[2], less[2];
    distances(at, n[22], lever, result);
    for (int place = 0; place < 5; place++) {
        double middle = at[place];
        at[place] = middle + steps[place];
        distances(at, n[22], lever, more);
        at[place] = middle - steps[place];
        distances(at, n[22], lever, less);
        at[place] = middle;
        for (int axis = 0; axis < 2; axis++) by[axis][place] = (more[axis] - less[axis]) / (2 * steps[place]);
    }
    for (int axis = 0; axis < 2; axis++) {
        double variance = pow(by[axis][4] * n[21] * DEGREE, 2) + n[26] * n[26];
        for (int row = 0; row < 4; row++)
            for (int column = 0; column < 4; column++)
                variance += by[axis][row] * covariance[4 * row + column] * by[axis][column];
        result[2 + axis] = sqrt(variance);
    }
}

int main(void) {
    double n[27], result[4];
    for (;;) {
        for (int place = 0; place < 27; place++)
            if (scanf("%lf", &n[place]) != 1) return place ? 1 : 0; /* 1: a line is incomplete */
        point(n, result);
        printf("%.4f %.4f %.4f %.4f\n", result[0], result[1], result[2], result[3]);
    }
}
