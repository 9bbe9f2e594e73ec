/* The fit of a spot and its misfit, as fit.py and misfit.py do them with numpy; those explain what is done.
 *
 * C11 without state. Arrays belong to the caller: doubles, row after row. kernel.py has the same structures,
 * blocks.py and fit.py the same rows.
 */
#include <math.h>
#include <string.h>

/* The rows of a fit, n values each: derivatives by the parameters, what follows from them, and a scratch one. */
enum { PEAK, U, V, A, B, C, OFFSET, RISE_X, RISE_Y, ORDER, RESIDUAL, NOISE, TEXTURE, SPOT, WEIGHTED };
/* The rows of the blocks of a spot's surroundings: blocks.py. */
enum { LIGHT, ONE, X, Y, XX, XY, YY, HALF_XX, HALF_XY, HALF_YY, F1, F2, READ_NOISE, SHOT_NOISE, SPOT_TEXTURE };
enum { PARAMETERS = RESIDUAL, MAX_PATTERNS = 27, RINGS = 5 };

struct fit_limits {
    double initial_contrast2, min_contrast2, max_contrast2, min_peak_share_for_contrast, converged_contrast2;
    double converged_sigmas, converged_shape, late_converged_sigmas, max_step, min_order, max_order;
    double order_prior_sigma, order_held_sigma;
    int max_iterations, late_iteration;
};

static double dot(int n, const double *restrict x, const double *restrict y) {
    double sum = 0;
    while (n--)
        sum += *x++ * *y++;
    return sum;
}

/* Inverts a positive definite matrix in place; 0 when it is none. */
static int invert(int size, double *matrix) {
    for (int k = 0; k < size; k++) {
        double *row = matrix + k * size, pivot = row[k];
        if (!(pivot > 0 && pivot < INFINITY))
            return 0;
        row[k] = 1;
        for (int j = 0; j < size; j++)
            row[j] /= pivot;
        for (int i = 0; i < size; i++)
            if (i != k) {
                double *other = matrix + i * size, factor = other[k];
                other[k] = 0;
                for (int j = 0; j < size; j++)
                    other[j] -= factor * row[j];
            }
    }
    return 1;
}

/* fit.py: _linearise and _block_mean_ratio */
static void linearise(int n, int has_moments, const double *from, const double *s, double *rows) {
    double peak = s[PEAK], u = s[U], v = s[V], a = s[A], b = s[B], c = s[C];
    double pull_u = a * u + b * v, pull_v = b * u + c * v, middle = (u * pull_u + v * pull_v) / 2;
    for (int i = 0; i < n; i++, from++, rows++) {
        double x = from[X * n], y = from[Y * n], xx = from[XX * n], xy = from[XY * n], yy = from[YY * n];
        double q = fmax(middle - pull_u * x - pull_v * y + a / 2 * xx + b * xy + c / 2 * yy, 1e-9);
        double by_u = a * x + b * y - pull_u, by_v = b * x + c * y - pull_v;
        double logarithm = log(q), raised = exp(s[ORDER] * logarithm), shape = exp(-raised);
        double steepness = s[ORDER] * raised / q, f2 = from[F2 * n];
        if (has_moments) {
            double half_xx = from[HALF_XX * n], half_xy = from[HALF_XY * n], half_yy = from[HALF_YY * n];
            double along_u = by_u * steepness, along_v = by_v * steepness;
            f2 *= 1 - steepness * (a * half_xx + b * half_xy + c * half_yy) +
                  (half_xx * along_u + half_xy * along_v) * along_u + half_yy * along_v * along_v;
        }
        double light = shape * f2 * peak, steep_light = light * steepness, spot = shape * peak;
        rows[PEAK * n] = shape * f2;
        rows[U * n] = by_u * steep_light;
        rows[V * n] = by_v * steep_light;
        rows[A * n] = (u * x - (u * u + xx) / 2) * steep_light;
        rows[B * n] = (v * x + u * y - u * v - xy) * steep_light;
        rows[C * n] = (v * y - (v * v + yy) / 2) * steep_light;
        rows[ORDER * n] = -light * raised * logarithm;
        rows[RESIDUAL * n] = from[LIGHT * n] - light - (s[OFFSET] + s[RISE_X] * x + s[RISE_Y] * y) * from[F1 * n];
        rows[SPOT * n] = spot;
        rows[NOISE * n] = from[READ_NOISE * n] + spot * from[SHOT_NOISE * n];
        rows[TEXTURE * n] = spot * spot * from[SPOT_TEXTURE * n];
    }
}

/* fit.py: _damped_step; 0 when none is possible */
static int damped_step(const struct fit_limits *limits, double *state, const double *step) {
    double largest = fmax(fabs(step[U]), fabs(step[V]));
    double sum = 0;
    for (int k = 0; k < PARAMETERS; k++) {
        sum += step[k];
        if (k == A || k == C || k == ORDER)
            largest = fmax(largest, fabs(step[k] / state[k]));
    }
    if (!isfinite(largest) || !isfinite(sum)) /* fmax passes over what is no number */
        return 0;
    for (double scale = fmin(1, limits->max_step / fmax(largest, 1e-12)); scale > 1e-3; scale /= 2) {
        double to[PARAMETERS];
        for (int k = 0; k < PARAMETERS; k++)
            to[k] = state[k] + scale * step[k];
        if (to[PEAK] > 0 && to[A] > 0 && to[C] > 0 && to[A] * to[C] > to[B] * to[B]) {
            to[ORDER] = fmin(fmax(to[ORDER], limits->min_order), limits->max_order);
            memcpy(state, to, sizeof to);
            return 1;
        }
    }
    return 0;
}

/* What noise does to the centre, or else texture (which is NOISE or TEXTURE): the mean square of both axes. */
static double centre_variance(int n, const double *covariance, const double *rows, double contrast2, int which) {
    double sum = 0;
    for (int i = 0; i < n; i++) {
        double weight = 1 / (rows[NOISE * n + i] + contrast2 * rows[TEXTURE * n + i]), by_u = 0, by_v = 0;
        for (int k = 0; k < PARAMETERS; k++) {
            by_u += covariance[U * PARAMETERS + k] * rows[k * n + i];
            by_v += covariance[V * PARAMETERS + k] * rows[k * n + i];
        }
        sum += (by_u * by_u + by_v * by_v) * weight * weight * rows[which * n + i] / 2;
    }
    return which == TEXTURE ? contrast2 * sum : sum;
}

static void add_priors(const double *state, double rise, double order_sigma, double *equations, double *right) {
    for (int k = RISE_X; k <= ORDER; k++) {
        double known = k == ORDER, sigma = k == ORDER ? order_sigma : rise;
        equations[k * PARAMETERS + k] += 1 / (sigma * sigma);
        right[k] += (known - state[k]) / (sigma * sigma);
    }
}

/* fit.py: solve_by_numpy. The state is replaced by the converged one; 0 when it does not converge. */
int altd_fit(const struct fit_limits *limits, int n, int has_moments, const double *blocks, double rise,
             int order_free_iteration, double *state, double *rows, double *noise_of_centre, double *contrast_found) {
    double contrast2 = limits->initial_contrast2, contrast2_before = contrast2, *weighted = rows + WEIGHTED * n;
    const double *noise = rows + NOISE * n, *texture = rows + TEXTURE * n, *spot = rows + SPOT * n;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < n; i++)
            rows[(OFFSET + k) * n + i] = blocks[F1 * n + i] * blocks[(ONE + k) * n + i];
    for (int iteration = 0; iteration < limits->max_iterations; iteration++) {
        linearise(n, has_moments, blocks, state, rows);
        int is_order_free = iteration >= order_free_iteration;
        if (is_order_free) {
            double unexplained = 0, per_contrast2 = 0;
            for (int i = 0; i < n; i++) {
                double residual = rows[RESIDUAL * n + i];
                double bright = spot[i] > limits->min_peak_share_for_contrast * state[PEAK];
                unexplained += bright * (residual * residual - noise[i]);
                per_contrast2 += bright * texture[i];
            }
            if (!(per_contrast2 > 0))
                return 0;
            contrast2_before = contrast2;
            contrast2 = fmin(fmax(unexplained / per_contrast2, limits->min_contrast2), limits->max_contrast2);
        }
        double equations[PARAMETERS * PARAMETERS], right[PARAMETERS], step[PARAMETERS];
        for (int k = 0; k < PARAMETERS; k++) {
            for (int i = 0; i < n; i++)
                weighted[i] = rows[k * n + i] / (noise[i] + contrast2 * texture[i]);
            for (int j = k; j < PARAMETERS; j++)
                equations[k * PARAMETERS + j] = equations[j * PARAMETERS + k] = dot(n, weighted, rows + j * n);
            right[k] = dot(n, weighted, rows + RESIDUAL * n);
        }
        double order_sigma = is_order_free ? limits->order_prior_sigma : limits->order_held_sigma;
        add_priors(state, rise, order_sigma, equations, right);
        if (!invert(PARAMETERS, equations))
            return 0;
        for (int k = 0; k < PARAMETERS; k++)
            step[k] = dot(PARAMETERS, equations + k * PARAMETERS, right);
        double change[PARAMETERS];
        memcpy(change, state, sizeof change);
        if (!damped_step(limits, state, step))
            return 0;
        for (int k = 0; k < PARAMETERS; k++)
            change[k] = fabs(state[k] - change[k]);
        double moved = fmax(change[U], change[V]);
        int is_steady = fabs(contrast2 - contrast2_before) < limits->converged_contrast2 * contrast2;
        int is_converged = iteration >= limits->late_iteration
            ? moved < limits->late_converged_sigmas
            : is_steady && moved <= limits->converged_sigmas &&
                  fmax(fmax(change[A], change[C]), change[ORDER]) < limits->converged_shape;
        if (!is_order_free || !is_converged)
            continue;
        *contrast_found = contrast2;
        *noise_of_centre = centre_variance(n, equations, rows, contrast2, NOISE);
        return 1;
    }
    return 0;
}

/* The harmonics of a ring are those from first to before last. */
struct rings {
    double levels[RINGS + 1], ridge_share;
    int first[RINGS], last[RINGS], min_blocks;
};

struct misfit { double chi2, degrees_of_freedom, uu, uv, vv, pattern_variance, scores[2 * MAX_PATTERNS]; };

static int ring_of(const struct rings *rings, double irradiance) { /* -1: none */
    int ring = -1;
    while (ring < RINGS - 1 && irradiance <= rings->levels[ring + 1])
        ring++;
    return ring;
}

/* misfit.py: _patterns, the light of a block in the harmonics of its ring; how many. block is its column. */
static int patterns_of(const struct rings *rings, int ring, int n, const double *block, const double *s, double spot,
                       double *pattern) {
    double x = block[X * n] - s[U], y = block[Y * n] - s[V], root = sqrt(s[A] * s[C] - s[B] * s[B]);
    double u = (s[A] + root) * x + s[B] * y, v = s[B] * x + (s[C] + root) * y;
    double length = fmax(sqrt(u * u + v * v), 1e-12), u2, v2;
    u /= length, v /= length, u2 = u * u - v * v, v2 = 2 * u * v;
    const double harmonics[] = {1, u, v, u2, v2, u2 * u - v2 * v, u2 * v + v2 * u};
    double light = ring == RINGS - 1 ? s[PEAK] * block[F1 * n] : spot * block[F2 * n];
    int count = rings->last[ring] - rings->first[ring];
    for (int h = 0; h < count; h++)
        pattern[h] = light * harmonics[rings->first[ring] + h];
    return count;
}

/* misfit.py: misfit_by_numpy; 0 where there are too few blocks to tell, or no solution */
int altd_misfit(const struct rings *rings, int n, const double *blocks, const double *state, const double *rows,
                double rise, double order_sigma, double contrast, struct misfit *to) {
    enum { P = PARAMETERS, M = MAX_PATTERNS };
    int members[RINGS] = {0}, first[RINGS], count = 0;
    const double *spot = rows + SPOT * n;
    double equations[P * P] = {0}, right[P] = {0}, shared[M * P] = {0}, information[M * M] = {0}, score[M] = {0};
    for (int i = 0, ring; i < n; i++)
        if ((ring = ring_of(rings, spot[i] / state[PEAK])) >= 0)
            members[ring]++;
    for (int ring = 0; ring < RINGS; ring++) {
        first[ring] = members[ring] < rings->min_blocks ? -1 : count;
        if (first[ring] >= 0)
            count += rings->last[ring] - rings->first[ring];
    }
    if (!count)
        return 0;
    for (int i = 0; i < n; i++) {
        double weight = 1 / (rows[NOISE * n + i] + contrast * contrast * rows[TEXTURE * n + i]), by[P];
        double light = rows[RESIDUAL * n + i];
        for (int k = 0; k < P; k++)
            by[k] = rows[k * n + i];
        for (int k = 0; k < P; k++) {
            double weighted = weight * by[k];
            right[k] += weighted * light;
            for (int j = 0; j < P; j++)
                equations[k * P + j] += weighted * by[j];
        }
        double pattern[7];
        int ring = ring_of(rings, spot[i] / state[PEAK]), patterns = 0;
        if (ring >= 0 && first[ring] >= 0)
            patterns = patterns_of(rings, ring, n, blocks + i, state, spot[i], pattern);
        for (int h = 0; h < patterns; h++) {
            int row = first[ring] + h;
            double weighted = weight * pattern[h];
            score[row] += weighted * light;
            for (int k = 0; k < P; k++)
                shared[row * P + k] += weighted * by[k];
            for (int g = 0; g < patterns; g++)
                information[row * M + first[ring] + g] += weighted * pattern[g];
        }
    }
    add_priors(state, rise, order_sigma, equations, right);
    if (!invert(P, equations))
        return 0;
    double step[P], scale[M], ridged[M * M];
    int used[M], size = 0;
    for (int k = 0; k < P; k++)
        step[k] = dot(P, equations + k * P, right);
    for (int row = 0; row < count; row++)
        if (information[row * M + row] > 0) {
            scale[size] = 1 / sqrt(information[row * M + row]);
            used[size++] = row;
        }
    for (int r = 0; r < size; r++) {
        const double *of_row = shared + used[r] * P;
        double taken[P];
        for (int k = 0; k < P; k++)
            taken[k] = dot(P, equations + k * P, of_row);
        score[r] = (score[used[r]] - dot(P, of_row, step)) * scale[r];
        for (int c = 0; c < size; c++)
            ridged[r * size + c] = (information[used[r] * M + used[c]] - dot(P, taken, shared + used[c] * P)) *
                                       scale[r] * scale[c] + (r == c) * rings->ridge_share;
    }
    if (!size || !invert(size, ridged))
        return 0;
    to->chi2 = 0, to->degrees_of_freedom = size;
    memset(to->scores, 0, sizeof to->scores);
    for (int r = 0; r < size; r++) {
        double amplitude = dot(size, ridged + r * size, score);
        to->scores[used[r]] = score[r], to->scores[MAX_PATTERNS + used[r]] = amplitude;
        to->chi2 += score[r] * amplitude;
        to->degrees_of_freedom -= rings->ridge_share * ridged[r * size + r];
    }
    to->uu = equations[U * P + U], to->uv = equations[U * P + V], to->vv = equations[V * P + V];
    to->pattern_variance = centre_variance(n, equations, rows, contrast * contrast, TEXTURE);
    return 1;
}
