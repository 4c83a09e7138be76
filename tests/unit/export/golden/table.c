/* table.h says what this is. Made by a program; change the model and export it again. */

#include "table.h"

#include <math.h>

typedef table_real real;

#ifdef TABLE_SINGLE
#define m_fabs fabsf
#else
#define m_fabs fabs
#endif

#define R(number) ((real)(number))

#define P_POINTS_0 R(0.115)

static real least(real a, real b)
{
    return (b < a) ? b : a;
}

static real largest(real a, real b)
{
    return (b > a) ? b : a;
}

/* a / b, rounded down; b is above zero. */
static int32_t floor_division(int32_t a, int32_t b)
{
    return (a >= 0) ? (a / b) : -((b - 1 - a) / b);
}

typedef struct {
    real v0;
    real v1;
    real v2;
} model_real_real_real;

static const real model_friction_table[28] = {
    R(0.0), R(4.0), R(19.0), R(0.0),
    R(0.0), R(6.0), R(0.0), R(0.02),
    R(0.1), R(0.3), R(1.0), R(3.0),
    R(10.0), R(0.115), R(0.105), R(0.088),
    R(0.083), R(0.087), R(0.1), R(0.0),
    R(0.0), R(0.0), R(0.0), R(0.0),
    R(0.0), R(0.0), R(0.0), R(0.0)
};

/* Compute the friction at rest, N m: it balances applied_torque up to the break_away level. */
static real model_curves_sticking(real applied_torque)
{
    if (applied_torque > R(0.115)) {
        return R(0.115);
    }
    if (applied_torque < R(-0.115)) {
        return R(-0.115);
    }
    return applied_torque;
}

/* Return the sign of velocity, 0 at 0; tanh(velocity / epsilon) if epsilon is above zero. */
static real model_curves_direction(real velocity)
{
    if (velocity > R(0.0)) {
        return R(1.0);
    }
    if (velocity < R(0.0)) {
        return R(-1.0);
    }
    return R(0.0);
}

/* Return the index of the last of n ascending x that is not above at; 0 if all are above. */
static int32_t model_table_interval(real at)
{
    int32_t high = 6;
    int32_t low = 0;
    while (high - low > 1) {
        const int32_t middle = floor_division(low + high, 2);
        if (model_friction_table[middle + 7] <= at) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

/* Compute the slope at an inner point: weighted harmonic mean of the slopes d over lengths h, 0 at an extremum. */
static real model_table_inner_slope(real h0, real h1, real d0, real d1)
{
    if (d0 * d1 <= R(0.0)) {
        return R(0.0) * d0;
    }
    const real w0 = R(2.0) * h1 + h0;
    const real w1 = h1 + R(2.0) * h0;
    return (w0 + w1) / (w0 / d0 + w1 / d1);
}

/* Compute the slope at an end: that of the parabola through three points, limited against overshoot. */
static real model_table_end_slope(real h0, real d0)
{
    const real slope = ((R(2.0) * h0 + R(0.19999999999999998)) * d0 - h0 * R(-0.08500000000000002)) / (h0 + R(0.19999999999999998));
    if (slope * d0 <= R(0.0)) {
        return R(0.0) * d0;
    }
    if ((d0 * R(-0.08500000000000002) <= R(0.0)) && (m_fabs(slope) > R(3.0) * m_fabs(d0))) {
        return R(3.0) * d0;
    }
    return slope;
}

/* Compute the slope at an end: that of the parabola through three points, limited against overshoot. */
static real model_table_end_slope_2(real h0, real d0)
{
    const real slope = ((R(2.0) * h0 + R(2.0)) * d0 - h0 * R(0.001999999999999995)) / (h0 + R(2.0));
    if (slope * d0 <= R(0.0)) {
        return R(0.0) * d0;
    }
    if ((d0 * R(0.001999999999999995) <= R(0.0)) && (m_fabs(slope) > R(3.0) * m_fabs(d0))) {
        return R(3.0) * d0;
    }
    return slope;
}

/* Compute the coefficients of _curve for the piece that begins at point low; constant beyond the last point. */
static model_real_real_real model_table_coefficients(int32_t low)
{
    const real zero = R(0.0) * model_friction_table[low + 13];
    const int32_t high = low + 1;
    if (high == 6) {
        return (model_real_real_real){zero, zero, zero};
    }
    const real h = model_friction_table[high + 7] - model_friction_table[low + 7];
    const real d = (model_friction_table[high + 13] - model_friction_table[low + 13]) / h;
    real left;
    if (low > 0) {
        const real h_before = model_friction_table[low + 7] - model_friction_table[low - 1 + 7];
        left = model_table_inner_slope(h_before, h, (model_friction_table[low + 13] - model_friction_table[low - 1 + 13]) / h_before, d);
    } else {
        left = model_table_end_slope(h, d);
    }
    real right;
    if (high < 5) {
        const real h_after = model_friction_table[high + 8] - model_friction_table[high + 7];
        right = model_table_inner_slope(h, h_after, d, (model_friction_table[high + 14] - model_friction_table[high + 13]) / h_after);
    } else {
        right = model_table_end_slope_2(h, d);
    }
    return (model_real_real_real){left, (R(3.0) * d - R(2.0) * left - right) / h, (left + right - R(2.0) * d) / (h * h)};
}

/* Evaluate a piece at the speed u above its first point. */
static real model_table_curve(real y, real linear, real quadratic, real cubic, real u)
{
    return y + u * (linear + u * (quadratic + u * cubic));
}

/* Compute the absolute torque of the table for motion in the direction sign. */
static real model_table_level_2(real velocity)
{
    const real at = m_fabs(velocity);
    if (at <= R(0.02)) {
        return P_POINTS_0;
    }
    const int32_t low = model_table_interval(at);
    real t1;
    real t2;
    real t3;
    {
        const model_real_real_real got = model_table_coefficients(low);
        t1 = got.v0;
        t2 = got.v1;
        t3 = got.v2;
    }
    const real linear = t1;
    const real quadratic = t2;
    const real cubic = t3;
    return model_table_curve(model_friction_table[low + 13], linear, quadratic, cubic, at - model_friction_table[low + 7]);
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_table_step(real velocity, real level_velocity, real applied_torque)
{
    if (velocity == R(0.0)) {
        return model_curves_sticking(applied_torque);
    }
    const real sign = model_curves_direction(velocity);
    const real level = model_table_level_2(level_velocity) + R(0.0);
    return level * sign;
}

/* Call step of the family. */
static real model_dispatch_family_step(real arguments_2, real arguments_3, real arguments_7)
{
    return model_table_step(arguments_2, arguments_3, arguments_7);
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(real velocity, real level_velocity, real applied_torque)
{
    return model_dispatch_family_step(velocity, level_velocity, applied_torque);
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(real velocity, real applied_torque)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real applied = least(largest(applied_torque, R(-1000000000.0)), R(1000000000.0));
    return model_kernel_step(held, held, applied);
}

void table_model_init(table_model *s)
{
    s->unused = 0U;
}

table_real table_model_step(
    table_model *s, table_real velocity, table_real dt, double position, table_real load_torque, table_real
    temperature, table_real applied_torque)
{
    (void)s;
    (void)dt;
    (void)position;
    (void)load_torque;
    (void)temperature;
    return model_bounded(velocity, applied_torque);
}
