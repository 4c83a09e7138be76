/* The rigid simulated servo in torque mode (CST), in plain C, for the test beside it: torque lag, LuGre friction by its
 * exact step, semi-implicit Euler, and the drive's encoder and velocity filter. SI units.
 */
#include <math.h>

static double sign(double x)
{
    return (x > 0.0) - (x < 0.0);
}

/* p: inertia, dt, lag coefficient, counts per rad, steps per control sample, velocity coefficient, then LuGre's
 * sigma0, sigma1, sigma2, Fc, Fs, vs, vd.   s: position, velocity, torque, deflection, counts, velocity estimate */
void servo(const double *restrict p, double demand, long n, double *restrict s)
{
    const double inertia = p[0], dt = p[1], lag = p[2], counts_per_unit = p[3], every = p[4], fraction = p[5];
    const double sigma0 = p[6], sigma1 = p[7], sigma2 = p[8], coulomb = p[9], hump = p[10] - p[9], vs = p[11], vd = p[12];
    double position = s[0], v = s[1], torque = s[2], z = s[3], counts = s[4], estimate = s[5], wait = 0.0;
    for (long k = 0; k < n; k++) {
        if (wait <= 0.0) {
            const double now = floor(position * counts_per_unit);
            estimate += fraction * ((now - counts) / (counts_per_unit * every * dt) - estimate);
            counts = now;
            wait = every;
        }
        wait -= 1.0;
        torque += lag * (demand - torque);
        const double x = v / vs, y = v / vd, before = z;
        const double level = coulomb + hump * exp(-x * x), settled = level / sigma0 * sign(v);
        z = settled + (z - settled) * exp(-sigma0 * fabs(v) * dt / level);
        const double friction = sigma0 * z + sigma1 * exp(-y * y) * ((z - before) / dt) + sigma2 * v;
        v += dt / inertia * (torque - friction);
        position += dt * v;
    }
    s[0] = position;
    s[1] = v;
    s[2] = torque;
    s[3] = z;
    s[4] = counts;
    s[5] = estimate;
}
