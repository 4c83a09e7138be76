/* karnopp.h says what this is. Made by a program; change the model and export it again. */

#include "karnopp.h"

#include <math.h>

typedef karnopp_real real;

#ifdef KARNOPP_SINGLE
#define m_exp expf
#define m_fabs fabsf
#else
#define m_exp exp
#define m_fabs fabs
#endif

#define R(number) ((real)(number))

#define P_COULOMB R(0.08)
#define P_STICK_VELOCITY R(0.001)
#define P_STRIBECK_VELOCITY R(0.2)
#define P_VISCOUS R(0.002)

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
    if (applied_torque > R(0.12)) {
        return R(0.12);
    }
    if (applied_torque < R(-0.12)) {
        return R(-0.12);
    }
    return applied_torque;
}

/* Compute x^y for x >= 0 and y >= 0; exactly x and x * x for y = 1 and 2. */
static real model_elementary_power(real x)
{
    return x * x;
}

/* Compute the level g(v) = Fc + (Fs - Fc) exp(-(abs(v)/vs)^delta), N m, even in velocity. */
static real model_curves_stribeck_level(real velocity)
{
    return P_COULOMB + R(0.039999999999999994) * m_exp(-model_elementary_power(m_fabs(velocity) / P_STRIBECK_VELOCITY));
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

/* Compute the torque of level and viscous friction, level sgn v + Fv v, N m. */
static real model_curves_sliding(real level, real velocity, real level_velocity)
{
    return level * model_curves_direction(velocity) + P_VISCOUS * level_velocity;
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_stribeck_step(real velocity, real level_velocity, real applied_torque)
{
    if (velocity == R(0.0)) {
        return model_curves_sticking(applied_torque);
    }
    const real level = model_curves_stribeck_level(level_velocity) + R(0.0);
    return model_curves_sliding(level, velocity, level_velocity);
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. A feed-forward ignores the band. */
static real model_karnopp_step(real velocity, real level_velocity, real applied_torque)
{
    if (m_fabs(velocity) < P_STICK_VELOCITY) {
        return model_curves_sticking(applied_torque);
    }
    return model_stribeck_step(velocity, level_velocity, applied_torque);
}

/* Call step of the family. */
static real model_dispatch_family_step(real arguments_2, real arguments_3, real arguments_7)
{
    return model_karnopp_step(arguments_2, arguments_3, arguments_7);
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

void karnopp_model_init(karnopp_model *s)
{
    s->unused = 0U;
}

karnopp_real karnopp_model_step(
    karnopp_model *s, karnopp_real velocity, karnopp_real dt, double position, karnopp_real load_torque,
    karnopp_real temperature, karnopp_real applied_torque)
{
    (void)s;
    (void)dt;
    (void)position;
    (void)load_torque;
    (void)temperature;
    return model_bounded(velocity, applied_torque);
}
