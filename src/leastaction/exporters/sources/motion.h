/* The motion of one instance, whatever the version of FMI. Value references are places in `value`. */
#ifndef MOTION_H
#define MOTION_H

#include <stddef.h>

#include "model.h"

enum {
    TIME = 0,
    Q = 1,
    QDOT = Q + N_DOF,
    QDDOT = QDOT + N_DOF,
    ENERGY = QDDOT + N_DOF,
    FORCES = ENERGY + 1,
    MAX_STEP = FORCES + N_DOF,
    COEFFICIENTS = MAX_STEP + 1,
    N_VALUES = COEFFICIENTS + N_COEFFICIENTS
};

typedef enum { BEFORE, INITIALISING, STEPPING, ENDED } Phase;

typedef struct {
    Phase phase;
    int stuck; /* The last step could not be done, and a shorter one would only come closer to the end. */
    double value[N_VALUES];
} Motion;

/* What can fail returns NULL, or a sentence on what is wrong; the motion is then as it was. */
void motion_reset(Motion *motion);
const char *motion_set(Motion *motion, size_t reference, double value);
const char *motion_get(const Motion *motion, size_t reference, double *value);
const char *motion_step(Motion *motion, double from, double size);

#endif
