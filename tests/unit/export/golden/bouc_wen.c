/* bouc_wen.h says what this is. Made by a program; change the model and export it again. */

#include "bouc_wen.h"

#include <math.h>

typedef bouc_wen_real real;

#ifdef BOUC_WEN_SINGLE
#define m_exp expf
#define m_expm1 expm1f
#define m_fabs fabsf
#define m_log1p log1pf
#else
#define m_exp exp
#define m_expm1 expm1
#define m_fabs fabs
#define m_log1p log1p
#endif

#define R(number) ((real)(number))

#define P_STIFFNESS R(400.0)
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

/* Compute the mean of e^-t for t from 0 to x, of either sign: (1 - e^-x) / x. */
static real model_elementary_mean_decay(real x)
{
    if (x > R(1e-05)) {
        return -m_expm1(-x) / x;
    }
    if (x < R(-1e-05)) {
        return -m_expm1(-(-x)) / (-x * m_exp(-(-x)));
    }
    return R(1.0) - x * (R(0.5) - x * (R(0.16666666666666666) - x / R(24.0)));
}

/* Compute the deflection after a step towards zero, which ends at zero, and the part of path it used. */
static model_real_real model_bouc_wen_back(real z, real target, real path)
{
    const real rate = target - R(0.2) * z;
    if (rate * target <= R(0.0)) {
        return (model_real_real){z, path};
    }
    const real after = z + path * model_elementary_mean_decay(path * R(0.2)) * rate;
    if (after * target < R(0.0)) {
        return (model_real_real){after, path};
    }
    const real bend = R(0.2) * z / rate;
    const real factor = (m_fabs(bend) > R(1e-05) ? m_log1p(bend) / bend : R(1.0) - bend * (R(0.5) - bend * (R(0.3333333333333333) - R(0.25) * bend)));
    const real crossing = R(0.0) - z / rate * factor;
    return (model_real_real){R(0.0) * z, (crossing < path ? crossing : path)};
}

/* Compute the deflection after a step away from zero: dz/dx = target - yielding z, not beyond the target. */
static real model_bouc_wen_away(real z, real target, real decayed)
{
    const real after = z + decayed * (target - z);
    return (((m_fabs(after) > m_fabs(target)) && (m_fabs(z) <= m_fabs(target))) ? target : after);
}

/* Compute the integral of exp(-slope x) for x from 0 to path, with slope >= 0. */
static real model_bouc_wen_decayed_path(real path)
{
    const real x = path;
    return path * (x > R(0.0) ? -m_expm1(-x) / x : R(1.0) - R(0.5) * x);
}

/* Compute the deflection after a path in the direction sign. */
static real model_bouc_wen_deflected(real z, real sign, real path)
{
    const real target = R(0.0002) * sign;
    real left = path;
    for (int32_t k = 0; k < 32; k++) {
        if (left <= R(0.0)) {
            break;
        }
        real h = left;
        if (z * target < R(0.0)) {
            real t1;
            real t2;
            {
                const model_real_real got = model_bouc_wen_back(z, target, h);
                t1 = got.v0;
                t2 = got.v1;
            }
            z = t1;
            h = t2;
        } else {
            z = model_bouc_wen_away(z, target, model_bouc_wen_decayed_path(h));
        }
        left = left - h;
    }
    return z;
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

/* Compute the path travelled in dt, A abs(v) dt, in settled deflections. */
static real model_bouc_wen_path(real velocity, real dt)
{
    const real path = m_fabs(velocity) * dt / R(0.0002);
    return (path < R(1000000.0) ? path : R(1000000.0));
}

/* Compute the torque at a deflection, scaled by the effect of load and temperature on the level. */
static real model_bouc_wen_torque(real z, real velocity)
{
    return P_STIFFNESS * z + P_VISCOUS * velocity;
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_bouc_wen_step(bouc_wen_model *s, real velocity, real level_velocity, real dt)
{
    s->friction[0] = model_bouc_wen_deflected(s->friction[0], model_curves_direction(velocity), model_bouc_wen_path(velocity, dt));
    return model_bouc_wen_torque(s->friction[0], level_velocity);
}

/* Call step of the family. */
static real model_dispatch_family_step(bouc_wen_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_bouc_wen_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(bouc_wen_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(bouc_wen_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void bouc_wen_model_init(bouc_wen_model *s)
{
    for (int32_t i = 0; i < 1; i++) {
        s->friction[i] = R(0.0);
    }
}

bouc_wen_real bouc_wen_model_step(
    bouc_wen_model *s, bouc_wen_real velocity, bouc_wen_real dt, double position, bouc_wen_real load_torque,
    bouc_wen_real temperature, bouc_wen_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
