/* A gated friction network as a plain C loop: what tools/bench neural measures our compiled network against.
 *
 * One hidden layer, one state, velocity as the only input; p as friction_hil.friction.network describes it.
 */

#include <math.h>

enum { SPEEDS = 4, INPUTS = 5, SEEN = 6, MOST_UNITS = 64, HEADER = 38 };

static inline double limited(double x, double bound) { return fmin(fmax(x, -bound), bound); }

void gated(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const int width = (int)p[4];
    const double scale = p[11], bound = p[12], tempo = p[10] / dt;
    const double *bias = p + HEADER, *first = bias + width, *aim = first + (INPUTS + 1) * width;
    const double *damping = aim + 1 + width + INPUTS, *direct = damping + 1 + width + INPUTS, *gate = direct + 1 + INPUTS;
    const double stroke = p[36];
    double y = 0.0, stop = 0.0, since = 0.0, h[MOST_UNITS];
    for (long k = 0; k < n; k++) {
        const double v = limited(velocity[k], p[13]);
        const double distance = velocity[k] * dt;
        stop = limited(stop + distance / stroke, 1.0);
        since = limited((since * distance > 0.0 ? since : 0.0) + distance / (0.25 * stroke), 1.0);
        const double x[INPUTS + 1] = {
            v / p[13], p[17] * asinh(v / p[14]), p[18] * asinh(v / p[15]), tanh(v / p[16]), stop, y};
        double seen[SEEN] = {[SPEEDS] = stop * x[SPEEDS - 1], [SPEEDS + 1] = fabs(since)};
        for (int i = 0; i < SPEEDS; i++)
            seen[i] = x[i] * x[i];
        for (int j = 0; j < width; j++)
            h[j] = bias[j];
        for (int i = 0; i <= INPUTS; i++)
            for (int j = 0; j < width; j++)
                h[j] += first[i * width + j] * x[i];
        for (int j = 0; j < width; j++)
            h[j] = tanh(h[j]);
        double goal = aim[0], rate_of_change = damping[0], total = direct[0], bend = gate[0], knee = gate[1 + SEEN];
        for (int j = 0; j < width; j++) {
            goal += aim[1 + j] * h[j];
            rate_of_change += damping[1 + j] * h[j];
        }
        for (int i = 0; i < INPUTS; i++) {
            goal += aim[1 + width + i] * x[i];
            rate_of_change += damping[1 + width + i] * x[i];
            total += direct[1 + i] * x[i];
        }
        for (int i = 0; i < SEEN; i++) {
            bend += gate[1 + i] * seen[i];
            knee += gate[2 + SEEN + i] * seen[i];
        }
        goal = limited(goal, bound);
        const double way = exp(p[25] + p[26] * tanh(bend)) * fabs(velocity[k]) * dt;
        const double knees = fabs(goal - y) / (bound * exp(0.5 * log(0.01) + 0.5 * log(400.0) * tanh(knee)));
        const double straight = fmin(fmax(knees - 1.0, 0.0), way), begun = straight / fmax(knees, 1.0);
        const double after = y + (begun - (1.0 - begun) * expm1(straight - way)) * (goal - y);
        total += after + rate_of_change * (after - y) * tempo;
        y = after;
        torque[k] = scale * limited(total, bound);
    }
}
