/* dahl.h says what this is. Made by a program; change the model and export it again. */

#include "dahl.h"

#include <math.h>

typedef dahl_real real;

#ifdef DAHL_SINGLE
#define m_expm1 expm1f
#define m_fabs fabsf
#else
#define m_expm1 expm1
#define m_fabs fabs
#endif

#define R(number) ((real)(number))

#define P_SIGMA0 R(2000.0)
#define P_VISCOUS R(0.002)

static real least(real a, real b)
{
    return (b < a) ? b : a;
}

static real largest(real a, real b)
{
    return (b > a) ? b : a;
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

/* Compute the path travelled in dt in units of Fc / sigma0: sigma0 abs(v) dt / Fc. */
static real model_dahl_path(real velocity, real dt)
{
    return P_SIGMA0 * m_fabs(velocity) * dt / R(0.08);
}

/* Compute the torque of one sample, exact for velocity held over dt; see friction_hil.friction.kernel. */
static real model_dahl_step(dahl_model *s, real velocity, real level_velocity, real dt)
{
    const real sign = model_curves_direction(velocity);
    const real before = s->friction[0];
    const real path = model_dahl_path(velocity, dt);
    const real after = before + -m_expm1(-path) * (R(0.08) * sign - before);
    s->friction[0] = after;
    return after + P_VISCOUS * level_velocity;
}

/* Call step of the family. */
static real model_dispatch_family_step(dahl_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_dahl_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(dahl_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(dahl_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void dahl_model_init(dahl_model *s)
{
    for (int32_t i = 0; i < 1; i++) {
        s->friction[i] = R(0.0);
    }
}

dahl_real dahl_model_step(
    dahl_model *s, dahl_real velocity, dahl_real dt, double position, dahl_real load_torque, dahl_real temperature,
    dahl_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
