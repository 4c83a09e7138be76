/* elasto_plastic.h says what this is. Made by a program; change the model and export it again. */

#include "elasto_plastic.h"

#include <math.h>

typedef elasto_plastic_real real;

#ifdef ELASTO_PLASTIC_SINGLE
#define m_cos cosf
#define m_exp expf
#define m_expm1 expm1f
#define m_fabs fabsf
#define m_sin sinf
#else
#define m_cos cos
#define m_exp exp
#define m_expm1 expm1
#define m_fabs fabs
#define m_sin sin
#endif

#define R(number) ((real)(number))

#define P_BREAKAWAY_RATIO R(0.7)
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

/* Compute the deflection after a path; both are in settled deflections, positive in the direction of motion. */
static real model_elasto_plastic_deflected(real y, real path)
{
    if (y < P_BREAKAWAY_RATIO) {
        const real elastic = P_BREAKAWAY_RATIO - y;
        if (path <= elastic) {
            return y + path;
        }
        path = path - elastic;
        y = P_BREAKAWAY_RATIO + R(0.0) * y;
    }
    if (path > R(50.0)) {
        return R(1.0) + R(0.0) * y;
    }
    real left = path;
    for (int32_t k = 0; k < 32; k++) {
        if (left <= R(0.0)) {
            break;
        }
        real h = left;
        if ((y < R(1.0)) && (k < 31) && (h > R(0.037500000000000006))) {
            h = R(0.037500000000000006);
        }
        real alpha;
        real slope;
        if (y < R(1.0)) {
            const real angle = R(10.471975511965976) * (y - R(0.85));
            alpha = R(0.5) * m_sin(angle) + R(0.5);
            slope = R(5.235987755982988) * m_cos(angle);
        } else {
            alpha = R(1.0);
            slope = R(0.0);
        }
        real after = y + h * model_elementary_mean_decay(h * (alpha + slope * y)) * (R(1.0) - alpha * y);
        if (h > R(0.037500000000000006)) {
            const real least = y + -m_expm1(-h) * (R(1.0) - y);
            after = (after < least ? least : after);
        }
        y = (((after > R(1.0)) && (y < R(1.0))) ? R(1.0) + R(0.0) * after : after);
        left = left - h;
    }
    return y;
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

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_elasto_plastic_step(elasto_plastic_model *s, real velocity, real level_velocity, real dt)
{
    const real level = model_lugre_level_at(level_velocity);
    const real settled = level / P_SIGMA0;
    const real before = s->friction[0];
    real after = before;
    if (velocity != R(0.0)) {
        const real sign = model_curves_direction(velocity);
        after = settled * sign * model_elasto_plastic_deflected(before * sign / settled, m_fabs(velocity) * dt / settled);
    }
    s->friction[0] = after;
    return model_lugre_torque(before, after, model_lugre_damping(level_velocity), level_velocity, dt);
}

/* Call step of the family. */
static real model_dispatch_family_step(elasto_plastic_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_elasto_plastic_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(elasto_plastic_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(elasto_plastic_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void elasto_plastic_model_init(elasto_plastic_model *s)
{
    for (int32_t i = 0; i < 1; i++) {
        s->friction[i] = R(0.0);
    }
}

elasto_plastic_real elasto_plastic_model_step(
    elasto_plastic_model *s, elasto_plastic_real velocity, elasto_plastic_real dt, double position,
    elasto_plastic_real load_torque, elasto_plastic_real temperature, elasto_plastic_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
