/* coulomb.h says what this is. Made by a program; change the model and export it again. */

#include "coulomb.h"

#include <math.h>

typedef coulomb_real real;

#ifdef COULOMB_SINGLE

#else

#endif

#define R(number) ((real)(number))

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
static real model_curves_sliding(real velocity, real level_velocity)
{
    return R(0.08) * model_curves_direction(velocity) + P_VISCOUS * level_velocity;
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_coulomb_step(real velocity, real level_velocity, real applied_torque)
{
    if (velocity == R(0.0)) {
        return model_curves_sticking(applied_torque);
    }
    return model_curves_sliding(velocity, level_velocity);
}

/* Call step of the family. */
static real model_dispatch_family_step(real arguments_2, real arguments_3, real arguments_7)
{
    return model_coulomb_step(arguments_2, arguments_3, arguments_7);
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

void coulomb_model_init(coulomb_model *s)
{
    s->unused = 0U;
}

coulomb_real coulomb_model_step(
    coulomb_model *s, coulomb_real velocity, coulomb_real dt, double position, coulomb_real load_torque,
    coulomb_real temperature, coulomb_real applied_torque)
{
    (void)s;
    (void)dt;
    (void)position;
    (void)load_torque;
    (void)temperature;
    return model_bounded(velocity, applied_torque);
}
