#include "motion.h"

#include <math.h>
#include <string.h>

void motion_reset(Motion *motion)
{
    static const double coefficients[N_COEFFICIENTS] = START_COEFFICIENTS;
    memset(motion, 0, sizeof *motion);
    motion->phase = BEFORE;
    motion->value[MAX_STEP] = START_MAX_STEP;
    memcpy(motion->value + COEFFICIENTS, coefficients, sizeof coefficients);
}

const char *motion_set(Motion *motion, size_t reference, double value)
{
    if (reference >= N_VALUES) return "there is no variable of this value reference";
    if (reference == TIME || (reference >= QDDOT && reference < FORCES))
        return "this variable is computed and cannot be set";
    if (motion->phase == ENDED) return "the simulation has ended; reset the instance";
    if (reference < QDDOT && motion->phase == STEPPING)
        return "coordinates and velocities can be set before the end of the initialisation only";
    if (!isfinite(value)) return "the value is not a finite number";
    if (reference == MAX_STEP && value <= 0.0) return "max_step must be positive";
    motion->value[reference] = value;
    return NULL;
}

const char *motion_get(const Motion *motion, size_t reference, double *value)
{
    const double *const v = motion->value;
    if (reference >= N_VALUES) return "there is no variable of this value reference";
    if (reference >= QDDOT && reference < ENERGY) {
        double qddot[N_DOF];
        leastaction_acceleration(v + COEFFICIENTS, AT(v + Q, v + QDOT, v[TIME]), v + FORCES, qddot);
        *value = qddot[reference - QDDOT];
    } else if (reference == ENERGY) {
        *value = leastaction_energy(v + COEFFICIENTS, AT(v + Q, v + QDOT, v[TIME]));
    } else {
        *value = v[reference];
    }
    return NULL;
}

/* Derivative of (q, qdot). */
static void rates(const double *parameters, const double *forces, double t, const double *state, double *out)
{
    (void)t;
    for (int i = 0; i < N_DOF; i++) out[i] = state[N_DOF + i];
    leastaction_acceleration(parameters, AT(state, state + N_DOF, t), forces, out + N_DOF);
}

/* One step of the classical Runge-Kutta method of degree 4. */
static void runge_kutta(const double *parameters, const double *forces, double t, double h, double *state)
{
    static const double part[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    double sum[2 * N_DOF] = {0.0}, slope[2 * N_DOF] = {0.0}, at[2 * N_DOF];
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < 2 * N_DOF; i++) at[i] = state[i] + part[stage] * h * slope[i];
        rates(parameters, forces, t + part[stage] * h, at, slope);
        for (int i = 0; i < 2 * N_DOF; i++) sum[i] += weight[stage] * slope[i];
    }
    for (int i = 0; i < 2 * N_DOF; i++) state[i] += h / 6.0 * sum[i];
}

const char *motion_step(Motion *motion, double from, double size)
{
    double *const v = motion->value;
    double state[2 * N_DOF];
    motion->stuck = 0;
    if (motion->phase != STEPPING) return "a step is possible after the initialisation only";
    if (!isfinite(from) || !(size > 0.0) || !isfinite(size)) return "the step size must be positive";
    const double count = fmax(1.0, ceil(size / v[MAX_STEP] - 1e-9));
    if (count > 1e9) return "the step is more than 1e9 times max_step; make max_step larger";
    memcpy(state, v + Q, sizeof state);
    for (long k = 0; k < (long)count; k++) {
        runge_kutta(v + COEFFICIENTS, v + FORCES, from + (double)k * (size / count), size / count, state);
        for (int i = 0; i < 2 * N_DOF; i++)
            if (!isfinite(state[i])) {
                motion->stuck = 1;
                return "the motion cannot be followed: the mass matrix is singular, a function is not "
                       "defined here, or the motion diverges";
            }
    }
    memcpy(v + Q, state, sizeof state);
    v[TIME] = from + size;
    return NULL;
}
