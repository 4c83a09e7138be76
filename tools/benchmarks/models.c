/* The friction models as plain C loops: what tools/bench models measures our compiled models against.
 *
 * Every function has the form NAME(p, velocity, n, dt, torque): n samples from rest, velocity held over dt, nothing
 * applied. p has the parameters in the order of the model's table, a list preceded by its length, words left out.
 */

#include <math.h>

enum { MOST_ELEMENTS = 20, MOST_POINTS = 64 };

static inline double sign(double x) { return (x > 0.0) - (x < 0.0); }

void coulomb(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double level = p[0], viscous = p[2];
    (void)dt;
    for (long k = 0; k < n; k++)
        torque[k] = level * sign(velocity[k]) + viscous * velocity[k];
}

static inline double stribeck_level(double v, double coulomb, double extra, double stribeck_velocity)
{
    const double ratio = v / stribeck_velocity;
    return coulomb + extra * exp(-ratio * ratio);
}

void stribeck(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double coulomb = p[0], extra = p[1] - p[0], stribeck_velocity = p[2], exponent = p[3], viscous = p[4];
    (void)dt;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        if (v == 0.0) {
            torque[k] = 0.0;
        } else {
            const double ratio = fabs(v) / stribeck_velocity;
            const double power = exponent == 2.0 ? ratio * ratio : pow(ratio, exponent);
            torque[k] = (coulomb + extra * exp(-power)) * sign(v) + viscous * v;
        }
    }
}

void karnopp(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double coulomb = p[0], extra = p[1] - p[0], stribeck_velocity = p[2], exponent = p[3], viscous = p[4];
    const double stick_velocity = p[5];
    (void)dt;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        if (fabs(v) < stick_velocity || v == 0.0) {
            torque[k] = 0.0;
        } else {
            const double ratio = fabs(v) / stribeck_velocity;
            const double power = exponent == 2.0 ? ratio * ratio : pow(ratio, exponent);
            torque[k] = (coulomb + extra * exp(-power)) * sign(v) + viscous * v;
        }
    }
}

void power_law(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double coulomb = p[0], factor = p[1], exponent = p[2];
    (void)dt;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        torque[k] = (coulomb + factor * pow(fabs(v), exponent)) * sign(v);
    }
}

void armstrong(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double coulomb = p[0], viscous = p[1], released = p[2], rested = p[3], stribeck_velocity = p[4];
    const double lag = p[5] / dt, rise = p[6], stiffness = p[7];
    const long lag_samples = (long)lag;
    const double part = lag - (double)lag_samples;
    double sliding = 0.0, deflection = 0.0, dwell = 0.0, lowest = released, break_away = released;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        const long past = k - lag_samples;
        const double late = past >= 0 ? velocity[past] : 0.0, later = past >= 1 ? velocity[past - 1] : 0.0;
        const double ratio = (late + part * (later - late)) / stribeck_velocity, fall = 1.0 / (1.0 + ratio * ratio);
        if (sliding != 0.0 && v * sliding <= 0.0) {
            const double reached = coulomb + (break_away - coulomb) * fall;
            lowest = fmax(reached, released);
            deflection = reached * sliding / stiffness;
            sliding = dwell = 0.0;
        }
        if (sliding == 0.0) {
            deflection += v * dt;
            dwell += dt;
            const double level = lowest + (rested - lowest) * dwell / (dwell + rise), spring = stiffness * deflection;
            if (fabs(spring) <= level) {
                torque[k] = spring;
                continue;
            }
            sliding = sign(spring);
            break_away = level;
        }
        torque[k] = (coulomb + (break_away - coulomb) * fall) * sliding + viscous * v;
    }
}

/* slope of a monotone curve at an inner point, between intervals of lengths h and slopes d */
static double inner_slope(double h0, double h1, double d0, double d1)
{
    const double w0 = 2.0 * h1 + h0, w1 = 2.0 * h0 + h1;
    return d0 * d1 > 0.0 ? (w0 + w1) / (w0 / d0 + w1 / d1) : 0.0;
}

/* the same at an end, from the two intervals next to it */
static double end_slope(double h0, double h1, double d0, double d1)
{
    const double slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
    if (slope * d0 <= 0.0)
        return 0.0;
    return d0 * d1 <= 0.0 && fabs(slope) > 3.0 * fabs(d0) ? 3.0 * d0 : slope;
}

/* of three points or more, of one direction, in ascending order, with monotone interpolation */
void table(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const int last = (int)p[0] - 1;
    double x[MOST_POINTS], y[MOST_POINTS], h[MOST_POINTS], d[MOST_POINTS], slope[MOST_POINTS];
    double bend[MOST_POINTS], twist[MOST_POINTS];
    (void)dt;
    for (int i = 0; i <= last; i++) {
        x[i] = p[1 + 2 * i];
        y[i] = p[2 + 2 * i];
    }
    for (int i = 0; i < last; i++) {
        h[i] = x[i + 1] - x[i];
        d[i] = (y[i + 1] - y[i]) / h[i];
    }
    slope[0] = end_slope(h[0], h[1], d[0], d[1]);
    slope[last] = end_slope(h[last - 1], h[last - 2], d[last - 1], d[last - 2]);
    for (int i = 1; i < last; i++)
        slope[i] = inner_slope(h[i - 1], h[i], d[i - 1], d[i]);
    for (int i = 0; i < last; i++) {
        bend[i] = (3.0 * d[i] - 2.0 * slope[i] - slope[i + 1]) / h[i];
        twist[i] = (slope[i] + slope[i + 1] - 2.0 * d[i]) / (h[i] * h[i]);
    }
    for (long k = 0; k < n; k++) {
        const double speed = fabs(velocity[k]);
        double level;
        if (speed <= x[0]) {
            level = y[0];
        } else if (speed >= x[last]) {
            level = y[last];
        } else {
            int low = 0, high = last;
            while (high - low > 1) {
                const int middle = (low + high) / 2;
                if (x[middle] <= speed)
                    low = middle;
                else
                    high = middle;
            }
            const double u = speed - x[low];
            level = y[low] + u * (slope[low] + u * (bend[low] + u * twist[low]));
        }
        torque[k] = level * sign(velocity[k]);
    }
}

void dahl(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double sigma0 = p[0], coulomb = p[1], exponent = p[2], viscous = p[3];
    double force = 0.0;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        if (v != 0.0) {
            const double limit = coulomb * sign(v), path = sigma0 * fabs(v) * dt / coulomb;
            if (exponent == 1.0) {
                force = limit + (force - limit) * exp(-path);
            } else if (force != limit) {
                const double power = 1.0 - exponent;
                const double rest = pow(1.0 - force / limit, power) - power * path;
                force = rest > 0.0 ? limit * (1.0 - pow(rest, 1.0 / power)) : limit;
            }
        }
        torque[k] = force + viscous * v;
    }
}

void lugre(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double sigma0 = p[0], sigma1 = p[1], sigma2 = p[2], coulomb = p[3], extra = p[4] - p[3];
    const double stribeck_velocity = p[5], damping_velocity = p[6];
    const int fades = isfinite(damping_velocity);
    double z = 0.0;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k], before = z;
        const double level = stribeck_level(v, coulomb, extra, stribeck_velocity);
        const double limit = level / sigma0 * sign(v);
        z = limit + (z - limit) * exp(-sigma0 * fabs(v) * dt / level);
        double damping = sigma1;
        if (fades) {
            const double ratio = v / damping_velocity;
            damping *= exp(-ratio * ratio);
        }
        torque[k] = sigma0 * z + damping * ((z - before) / dt) + sigma2 * v;
    }
}

/* y, the deflection over the settled one, after a path over the settled one; see elasto_plastic.py */
static double deflected(double y, double path, double ratio)
{
    enum { MOST_STEPS = 32 };
    const double pi = 3.14159265358979323846, width = 1.0 - ratio, longest = width / 8.0;
    if (y < ratio) {
        if (path <= ratio - y)
            return y + path;
        path -= ratio - y;
        y = ratio;
    }
    for (int step = 1; y < 1.0 && path > 0.0; step++) {
        const double h = path > longest && step < MOST_STEPS ? longest : path;
        const double angle = pi * (y - 0.5 * (1.0 + ratio)) / width;
        const double alpha = 0.5 + 0.5 * sin(angle), slope = 0.5 * pi / width * cos(angle);
        const double rate = alpha + slope * y;
        double after = y + (rate != 0.0 ? -expm1(-rate * h) / rate : h) * (1.0 - alpha * y);
        if (h > longest)
            after = fmax(after, y - expm1(-h) * (1.0 - y));
        y = fmin(after, 1.0);
        path -= h;
    }
    return path > 0.0 ? 1.0 + (y - 1.0) * exp(-path) : y;
}

void elasto_plastic(const double *restrict p, const double *restrict velocity, long n, double dt,
                    double *restrict torque)
{
    const double sigma0 = p[0], sigma1 = p[1], sigma2 = p[2], coulomb = p[3], extra = p[4] - p[3];
    const double stribeck_velocity = p[5], damping_velocity = p[6], breakaway_ratio = p[7];
    const int fades = isfinite(damping_velocity);
    double z = 0.0;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k], before = z;
        if (v != 0.0) {
            const double settled = stribeck_level(v, coulomb, extra, stribeck_velocity) / sigma0 * sign(v);
            z = settled * deflected(z / settled, v * dt / settled, breakaway_ratio);
        }
        double damping = sigma1;
        if (fades) {
            const double ratio = v / damping_velocity;
            damping *= exp(-ratio * ratio);
        }
        torque[k] = sigma0 * z + damping * ((z - before) / dt) + sigma2 * v;
    }
}

void gms(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const int elements = (int)p[0];
    const double *stiffness = p + 1, *weight = stiffness + elements + 1, *rest = weight + elements;
    const double attraction = rest[0], coulomb = rest[1], extra = rest[2] - rest[1], stribeck_velocity = rest[3];
    const double viscous = rest[4];
    double force[MOST_ELEMENTS] = {0.0}, slipping[MOST_ELEMENTS] = {0.0}; /* slipping: direction, 0 while it sticks */
    for (long k = 0; k < n; k++) {
        const double v = velocity[k], direction = sign(v);
        double sum = 0.0;
        if (v == 0.0) {
            for (int i = 0; i < elements; i++) {
                slipping[i] = 0.0;
                sum += force[i];
            }
        } else {
            const double level = stribeck_level(v, coulomb, extra, stribeck_velocity);
            const double kept = exp(-attraction * dt / level), travel = v * dt;
            for (int i = 0; i < elements; i++) {
                const double limit = weight[i] * level * direction;
                if (slipping[i] == direction || (force[i] - limit) * direction > 0.0) {
                    slipping[i] = direction;
                    force[i] = limit + (force[i] - limit) * kept;
                } else {
                    force[i] += stiffness[i] * travel;
                    slipping[i] = 0.0;
                    if ((force[i] - limit) * direction > 0.0) {
                        slipping[i] = direction;
                        force[i] = limit;
                    }
                }
                sum += force[i];
            }
        }
        torque[k] = sum + viscous * v;
    }
}

/* of exponent 1 */
void bouc_wen(const double *restrict p, const double *restrict velocity, long n, double dt, double *restrict torque)
{
    const double stiffness = p[0], gain = p[1], beta = p[2], gamma = p[3], viscous = p[5];
    const double unloading = beta - gamma, loading = beta + gamma; /* rates along the path, before and after z = 0 */
    double z = 0.0;
    for (long k = 0; k < n; k++) {
        const double v = velocity[k];
        if (v != 0.0) {
            const double direction = sign(v);
            double y = z * direction, path = fabs(v) * dt;
            if (y < 0.0) {
                double crossing;
                if (unloading == 0.0) {
                    crossing = -y / gain;
                } else {
                    crossing = log1p(-y * unloading / gain) / unloading;
                }
                if (path < crossing) {
                    y = unloading == 0.0 ? y + gain * path
                                         : gain / unloading + (y - gain / unloading) * exp(-unloading * path);
                    path = 0.0;
                } else {
                    y = 0.0;
                    path -= crossing;
                }
            }
            if (path > 0.0)
                y = gain / loading + (y - gain / loading) * exp(-loading * path);
            z = y * direction;
        }
        torque[k] = stiffness * z + viscous * v;
    }
}
