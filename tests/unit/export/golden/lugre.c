/* lugre.h says what this is. Made by a program; change the model and export it again. */

#include "lugre.h"

#include <math.h>

typedef lugre_real real;

#ifdef LUGRE_SINGLE
#define m_exp expf
#define m_expm1 expm1f
#define m_fabs fabsf
#else
#define m_exp exp
#define m_expm1 expm1
#define m_fabs fabs
#endif

#define R(number) ((real)(number))

#define P_COULOMB R(0.08)
#define P_DAMPING_VELOCITY R(0.2)
#define P_SIGMA0 R(2000.0)
#define P_SIGMA2 R(0.002)
#define P_STRIBECK_VELOCITY R(0.2)

static real least(real a, real b)
{
    return (b < a) ? b : a;
}

static real largest(real a, real b)
{
    return (b > a) ? b : a;
}

/* Compute stribeck_level with exponent 2. */
static real model_curves_gaussian_level(real velocity)
{
    const real ratio = velocity / P_STRIBECK_VELOCITY;
    return P_COULOMB + R(0.039999999999999994) * m_exp(-(ratio * ratio));
}

/* Compute the level g(v), N m. */
static real model_lugre_level_at(real velocity)
{
    return model_curves_gaussian_level(velocity) + R(0.0);
}

/* Compute the fraction of the distance to that deflection covered in dt, exact for a held velocity. */
static real model_lugre_approached(real level, real velocity, real dt)
{
    return -m_expm1(-(P_SIGMA0 * m_fabs(velocity) * dt / level));
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

/* Compute the deflection that the bristles settle to, g / sigma0 sgn v, rad. */
static real model_lugre_slipped(real level, real velocity)
{
    return level / P_SIGMA0 * model_curves_direction(velocity);
}

/* Compute the torque of bristles whose deflection changed from before to after in dt, N m. */
static real model_lugre_torque(real before, real after, real damping, real velocity, real dt)
{
    return P_SIGMA0 * after + damping * ((after - before) / dt) + P_SIGMA2 * velocity;
}

/* Compute the bristle damping sigma1 exp(-(v/vd)^2), N m s/rad. */
static real model_lugre_damping(real velocity)
{
    const real fading = velocity / P_DAMPING_VELOCITY;
    return m_exp(-(fading * fading));
}

/* Compute the torque of one sample, exact for velocity held over dt; see friction_hil.friction.kernel. */
static real model_lugre_step(lugre_model *s, real velocity, real level_velocity, real dt)
{
    const real level = model_lugre_level_at(level_velocity);
    const real before = s->friction[0];
    const real after = before + model_lugre_approached(level, velocity, dt) * (model_lugre_slipped(level, velocity) - before);
    s->friction[0] = after;
    return model_lugre_torque(before, after, model_lugre_damping(level_velocity), level_velocity, dt);
}

/* Call step of the family. */
static real model_dispatch_family_step(lugre_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_lugre_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(lugre_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(lugre_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void lugre_model_init(lugre_model *s)
{
    for (int32_t i = 0; i < 1; i++) {
        s->friction[i] = R(0.0);
    }
}

lugre_real lugre_model_step(
    lugre_model *s, lugre_real velocity, lugre_real dt, double position, lugre_real load_torque, lugre_real
    temperature, lugre_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
