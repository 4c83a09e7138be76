/* armstrong.h says what this is. Made by a program; change the model and export it again. */

#include "armstrong.h"

#include <math.h>

typedef armstrong_real real;

#ifdef ARMSTRONG_SINGLE
#define m_fabs fabsf
#else
#define m_fabs fabs
#endif

#define R(number) ((real)(number))

#define P_COULOMB R(0.08)
#define P_LAG_S R(0.005)
#define P_RISE_S R(1.0)
#define P_STATIC_RELEASED R(0.1)
#define P_STATIC_RESTED R(0.13)
#define P_STIFFNESS R(2000.0)
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
    int32_t v0;
    real v1;
} model_int_real;

/* Return True if recorded velocities that are length seconds apart cover the lag. */
static bool model_armstrong_is_far_enough(real length)
{
    return length * R(29.0) >= P_LAG_S;
}

/* Record velocity in the ring of s, with the time since the previous one; return its ring index. */
static int32_t model_armstrong_record(armstrong_model *s, real velocity, real dt)
{
    int32_t newest = ((int32_t)s->friction[5]) & 31;
    const real length = s->friction[newest + 6];
    if (model_armstrong_is_far_enough(length)) {
        newest = (newest + 1) & 31;
        s->friction[5] = (real)newest;
        s->friction[newest + 6] = dt;
    } else {
        s->friction[newest + 6] = length + dt;
    }
    s->friction[newest + 38] = velocity;
    return newest;
}

/* Locate the time lag seconds ago in the ring; the oldest entry is the limit. */
static model_int_real model_armstrong_past(const armstrong_model *s, int32_t newest)
{
    real length = s->friction[newest + 6];
    int32_t back = 0;
    real left = P_LAG_S;
    while ((left >= length) && (back < 30)) {
        left = left - length;
        back = back + 1;
        length = s->friction[((newest - back) & 31) + 6];
    }
    return (model_int_real){back, (left < length ? left / length : R(1.0) + R(0.0) * left)};
}

/* Interpolate from the velocity later back to earlier. */
static real model_armstrong_between(real later, real earlier, real fraction)
{
    return later + fraction * (earlier - later);
}

/* Record velocity and return the velocity lag seconds ago, by linear interpolation; 0 before the start. */
static real model_armstrong_lagging_velocity(armstrong_model *s, real velocity, real dt)
{
    const int32_t t1 = model_armstrong_record(s, velocity, dt);
    const int32_t newest = t1;
    int32_t t2;
    real t3;
    {
        const model_int_real got = model_armstrong_past(s, newest);
        t2 = got.v0;
        t3 = got.v1;
    }
    const int32_t back = t2;
    const real fraction = t3;
    const int32_t later = (newest - back) & 31;
    const int32_t earlier = (later - 1) & 31;
    return model_armstrong_between(s->friction[later + 38], s->friction[earlier + 38], fraction);
}

/* Compute the fraction of the level's rise above Coulomb that remains at velocity. */
static real model_armstrong_fall(real velocity)
{
    const real ratio = velocity * R(5.0);
    return R(1.0) / (R(1.0) + ratio * ratio);
}

static real model_armstrong_level(real static_, real fall)
{
    return P_COULOMB + (static_ - P_COULOMB) * fall;
}

/* Compute the torque of one sample from its _fall; advance the state except the ring. */
static real model_armstrong_torque(armstrong_model *s, real velocity, real level_velocity, real fall, real dt)
{
    if (velocity * s->friction[0] <= R(0.0)) {
        if (s->friction[0] != R(0.0)) {
            const real reached = model_armstrong_level(s->friction[4], fall);
            const real above = reached - P_STATIC_RELEASED;
            s->friction[3] = (above > R(0.0) ? above : R(0.0) * above);
            s->friction[1] = (reached + R(0.0)) * s->friction[0] / P_STIFFNESS;
            s->friction[0] = R(0.0);
            s->friction[2] = R(0.0);
        }
        s->friction[1] = s->friction[1] + velocity * dt;
        s->friction[2] = s->friction[2] + dt;
        const real start = P_STATIC_RELEASED + s->friction[3];
        const real static_ = start + (P_STATIC_RESTED - start) * s->friction[2] / (s->friction[2] + P_RISE_S);
        const real spring = P_STIFFNESS * s->friction[1];
        if (m_fabs(spring) <= static_ + R(0.0)) {
            return spring;
        }
        s->friction[0] = (spring > R(0.0) ? R(1.0) : R(-1.0));
        s->friction[4] = static_;
    }
    return (model_armstrong_level(s->friction[4], fall) + R(0.0)) * s->friction[0] + P_VISCOUS * level_velocity;
}

/* Compute the torque of one sample; see friction_hil.friction.kernel. */
static real model_armstrong_step(armstrong_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_armstrong_lagging_velocity(s, level_velocity, dt);
    const real fall = model_armstrong_fall(t1);
    const real t2 = model_armstrong_torque(s, velocity, level_velocity, fall, dt);
    return t2;
}

/* Call step of the family. */
static real model_dispatch_family_step(armstrong_model *s, real arguments_2, real arguments_3, real arguments_4)
{
    const real t1 = model_armstrong_step(s, arguments_2, arguments_3, arguments_4);
    return t1;
}

/* Advance the state over one sample and return the friction torque. */
static real model_kernel_step(armstrong_model *s, real velocity, real level_velocity, real dt)
{
    const real t1 = model_dispatch_family_step(s, velocity, level_velocity, dt);
    return t1;
}

/* Advance a model with inputs of any size, so that no finite input makes a number that is none. */
static real model_bounded(armstrong_model *s, real velocity, real dt)
{
    const real held = least(largest(velocity, R(-1000000000.0)), R(1000000000.0));
    const real elapsed = least(dt, R(1000000000.0));
    const real t1 = model_kernel_step(s, held, held, elapsed);
    return t1;
}

void armstrong_model_init(armstrong_model *s)
{
    for (int32_t i = 0; i < 70; i++) {
        s->friction[i] = R(0.0);
    }
}

armstrong_real armstrong_model_step(
    armstrong_model *s, armstrong_real velocity, armstrong_real dt, double position, armstrong_real load_torque,
    armstrong_real temperature, armstrong_real applied_torque)
{
    (void)position;
    (void)load_torque;
    (void)temperature;
    (void)applied_torque;
    return model_bounded(s, velocity, dt);
}
