/* power_law.h says what this is. Made by a program; change the model and export it again. */

#include "power_law.h"

#include <math.h>

typedef power_law_real real;

#ifdef POWER_LAW_SINGLE
#define m_fabs fabsf
#define m_pow powf
#else
#define m_fabs fabs
#define m_pow pow
#endif

#define R(number) ((real)(number))

#define P_EXPONENT R(0.5)
#define P_FACTOR R(0.02)

static real least(real a, real b)
{
    return (b < a) ? b : a;
}

static real largest(real a, real b)
{
    return (b > a) ? b : a;
}

/* Compute the friction at rest, N m: it balances applied_torque up to the break_away level. */
static real model_curves_sticking(real applied_torque)
{
    if (applied_torque > R(0.08)) {
        return R(0.08);
    }
    if (applied_torque < R(-0.08)) {
        return R(-0.08);
    }
    return applied_torque;
}

/* Compute x^y for x >= 0 and y >= 0; exactly x and x * x for y = 1 and 2. */
static real model_elementary_power(real x)
{
    return m_pow(x, P_EXPONENT);
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

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_power_law_step(real velocity, real level_velocity, real applied_torque)
{
    if (velocity == R(0.0)) {
        return model_curves_sticking(applied_torque);
    }
    const real growing = P_FACTOR * model_elementary_power(m_fabs(level_velocity));
    return R(0.08) * model_curves_direction(velocity) + growing * model_curves_direction(level_velocity);
}

/* Call step of the family. */
static real model_dispatch_family_step(real arguments_2, real arguments_3, real arguments_7)
{
    return model_power_law_step(arguments_2, arguments_3, arguments_7);
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

void power_law_model_init(power_law_model *s)
{
    s->unused = 0U;
}

power_law_real power_law_model_step(
    power_law_model *s, power_law_real velocity, power_law_real dt, double position, power_law_real load_torque,
    power_law_real temperature, power_law_real applied_torque)
{
    (void)s;
    (void)dt;
    (void)position;
    (void)load_torque;
    (void)temperature;
    return model_bounded(velocity, applied_torque);
}
