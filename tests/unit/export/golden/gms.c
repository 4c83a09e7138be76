/* gms.h says what this is. Made by a program; change the model and export it again. */

#include "gms.h"

#include <math.h>

typedef gms_real real;

#ifdef GMS_SINGLE
#define m_exp expf
#define m_expm1 expm1f
#else
#define m_exp exp
#define m_expm1 expm1
#endif

#define R(number) ((real)(number))

#define P_ATTRACTION R(10.0)
#define P_COULOMB R(0.08)
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

typedef struct {
    real v0;
    real v1;
} model_real_real;

static const real model_friction_table[8] = {
    R(1600.0), R(560.0), R(200.0), R(60.0),
    R(0.25), R(0.3), R(0.25), R(0.2)
};

/* Compute stribeck_level with exponent 2. */
static real model_curves_gaussian_level(real velocity)
{
    const real ratio = velocity / P_STRIBECK_VELOCITY;
    return P_COULOMB + R(0.039999999999999994) * m_exp(-(ratio * ratio));
}

/* Compute the level s(v), N m. */
static real model_gms_level_at(real velocity)
{
    return model_curves_gaussian_level(velocity) + R(0.0);
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

/* Compute the fraction of the distance to its level that a slipping element covers in dt. */
static real model_gms_approached(real level, real dt)
{
    return -m_expm1(-(P_ATTRACTION * dt / level));
}

/* Advance the torque of an element and its direction of slip, slip, by one step. */
static model_real_real model_gms_advanced(real torque, real slip, real sign, real bound, real fraction, real gain)
{
    if ((sign != R(0.0)) && ((slip == sign) || (torque * sign > bound))) {
        return (model_real_real){torque + fraction * (bound * sign - torque), sign};
    }
    torque = torque + gain;
    if (torque * sign >= bound) {
        return (model_real_real){bound * sign, sign};
    }
    return (model_real_real){torque, R(0.0)};
}

/* Compute the torque of one sample, exact for velocity held over dt; see friction_hil.friction.kernel. */
static real model_gms_step(gms_model *s, real velocity, real level_velocity, real dt)
{
    const real level = model_gms_level_at(level_velocity);
    const real sign = model_curves_direction(velocity);
    const real fraction = model_gms_approached(level, dt);
    real total = P_VISCOUS * level_velocity;
    for (int32_t i = 0; i < 4; i++) {
        const real bound = model_friction_table[i + 4] * level;
        const real gain = model_friction_table[i] * (velocity * dt);
        real t1;
        real t2;
        {
            const model_real_real got = model_gms_advanced(s->friction[2 * i], s->friction[2 * i + 1], sign, bound, fraction, gain);
            t1 = got.v0;
            t2 = got.v1;
        }
        s->friction[2 * i] = t1;
        s->friction[2 * i + 1] = t2;
        total = total + s->friction[2 * i];
    }
    return total;
}

/* Call step of the family. */
static real model_dispatch_family_step(gms_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_gms_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(gms_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(gms_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void gms_model_init(gms_model *s)
{
    for (int32_t i = 0; i < 8; i++) {
        s->friction[i] = R(0.0);
    }
}

gms_real gms_model_step(
    gms_model *s, gms_real velocity, gms_real dt, double position, gms_real load_torque, gms_real temperature,
    gms_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
