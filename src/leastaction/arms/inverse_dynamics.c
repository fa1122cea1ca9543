/* Inverse dynamics of an arm with the joints @JOINTS_IN_WORDS@, written by leastaction.
   C99, needs math.h alone. Base parameters stand in place of the inertial parameters of the links: torques are
   right, links need not be bodies that can exist. Arrays hold one number for each joint; SI units. */
#include <math.h>

#define N @N_JOINTS@

typedef struct { int parent, revolute; double rotation[9], origin[3], axis[3]; } Joint;
typedef struct { int kind, joint; double value, width, speed; } Acting;

static const Joint TREE[N] = {
    @TREE_ROWS@
};
static const double GRAVITY[3] = @GRAVITY_VECTOR@;
/* m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz of each link about its joint */
static const double LINKS[N][10] = {
    @LINK_ROWS@
};
enum { ROTOR, SPRING, OFFSET, VISCOUS, DRY, STRIBECK, QUADRATIC, ASYMMETRIC };
static const Acting JOINTS[] = {
    @ACTING_ROWS@
};

static void cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out = R v, or its transpose */
static void turn(const double r[9], const double v[3], int back, double out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = 0.0;
        for (int j = 0; j < 3; j++) out[i] += (back ? r[3 * j + i] : r[3 * i + j]) * v[j];
    }
}

static void links(const double *q, const double *qdot, const double *qddot, double *tau) {
    double rot[N][9], shift[N][3], w[N][3], dw[N][3], acc[N][3], force[N][3], moment[N][3];
    double a[3], b[3];
    for (int k = 0; k < N; k++) {
        const Joint *joint = &TREE[k];
        const double *u = joint->axis;
        double wp[3] = {0.0, 0.0, 0.0}, dp[3] = {0.0, 0.0, 0.0};
        double ap[3] = {-GRAVITY[0], -GRAVITY[1], -GRAVITY[2]};
        if (joint->parent >= 0)
            for (int i = 0; i < 3; i++) {
                wp[i] = w[joint->parent][i];
                dp[i] = dw[joint->parent][i];
                ap[i] = acc[joint->parent][i];
            }
        for (int i = 0; i < 9; i++) rot[k][i] = joint->rotation[i];
        for (int i = 0; i < 3; i++) shift[k][i] = joint->origin[i];
        if (joint->revolute) {
            double s = sin(q[k]), c = 1.0 - cos(q[k]);
            double m[9] = {1.0 - c * (u[1] * u[1] + u[2] * u[2]), c * u[0] * u[1] - s * u[2], c * u[0] * u[2] + s * u[1],
                           c * u[0] * u[1] + s * u[2], 1.0 - c * (u[0] * u[0] + u[2] * u[2]), c * u[1] * u[2] - s * u[0],
                           c * u[0] * u[2] - s * u[1], c * u[1] * u[2] + s * u[0], 1.0 - c * (u[0] * u[0] + u[1] * u[1])};
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    rot[k][3 * i + j] = 0.0;
                    for (int l = 0; l < 3; l++) rot[k][3 * i + j] += joint->rotation[3 * i + l] * m[3 * l + j];
                }
        } else {
            turn(joint->rotation, u, 0, a);
            for (int i = 0; i < 3; i++) shift[k][i] += q[k] * a[i];
        }
        cross(dp, shift[k], a);
        for (int i = 0; i < 3; i++) ap[i] += a[i];
        cross(wp, shift[k], a);
        cross(wp, a, b);
        for (int i = 0; i < 3; i++) ap[i] += b[i];
        turn(rot[k], ap, 1, acc[k]);
        turn(rot[k], wp, 1, w[k]);
        turn(rot[k], dp, 1, dw[k]);
        for (int i = 0; i < 3; i++) a[i] = u[i] * qdot[k];
        cross(w[k], a, b);
        for (int i = 0; i < 3; i++) {
            if (joint->revolute) {
                dw[k][i] += u[i] * qddot[k] + b[i];
            } else {
                acc[k][i] += u[i] * qddot[k] + 2.0 * b[i];
            }
        }
        if (joint->revolute)
            for (int i = 0; i < 3; i++) w[k][i] += a[i];
    }
    for (int k = 0; k < N; k++) {
        const double *p = LINKS[k], *h = p + 1;
        const double inertia[9] = {p[4], p[5], p[6], p[5], p[7], p[8], p[6], p[8], p[9]};
        cross(dw[k], h, a);
        for (int i = 0; i < 3; i++) force[k][i] = p[0] * acc[k][i] + a[i];
        cross(w[k], h, a);
        cross(w[k], a, b);
        for (int i = 0; i < 3; i++) force[k][i] += b[i];
        turn(inertia, w[k], 0, a);
        cross(w[k], a, moment[k]);
        turn(inertia, dw[k], 0, a);
        cross(h, acc[k], b);
        for (int i = 0; i < 3; i++) moment[k][i] += a[i] + b[i];
    }
    for (int k = N - 1; k >= 0; k--) {
        const Joint *joint = &TREE[k];
        const double *f = joint->revolute ? moment[k] : force[k];
        tau[k] = joint->axis[0] * f[0] + joint->axis[1] * f[1] + joint->axis[2] * f[2];
        if (joint->parent >= 0) {
            double turned[3];
            turn(rot[k], force[k], 0, turned);
            turn(rot[k], moment[k], 0, a);
            cross(shift[k], turned, b);
            for (int i = 0; i < 3; i++) {
                force[joint->parent][i] += turned[i];
                moment[joint->parent][i] += a[i] + b[i];
            }
        }
    }
}

static double acting(const Acting *term, double q, double v, double a) {
    double size = sqrt(v * v + term->width * term->width), sign = term->width > 0.0 ? v / size : 0.0;
    switch (term->kind) {
    case ROTOR: return term->value * a;
    case SPRING: return term->value * q;
    case OFFSET: return term->value;
    case VISCOUS: return term->value * v;
    case DRY: return term->value * sign;
    case STRIBECK: return term->speed > 0.0 ? term->value * sign * exp(-v * v / (term->speed * term->speed)) : 0.0;
    case QUADRATIC: return term->value * v * size;
    default: return term->value * size;
    }
}

/* Torques of terms that were added to L. */
static void added(const double *q, const double *qdot, const double *qddot, double *tau) {
    (void)q, (void)qdot, (void)qddot, (void)tau;
    @LAW@
}

/* Torques of terms that were added to the dissipation function. */
static void lost(const double *qdot, double *tau) {
    (void)qdot, (void)tau;
    @LOSS@
}

/* Torques of a state: inverse dynamics. */
void arm_torques(const double q[N], const double qdot[N], const double qddot[N], double tau[N]) {
    links(q, qdot, qddot, tau);
    added(q, qdot, qddot, tau);
    lost(qdot, tau);
    for (int i = 0; i < @N_ACTING@; i++) {
        int k = JOINTS[i].joint;
        tau[k] += acting(&JOINTS[i], q[k], qdot[k], qddot[k]);
    }
}

/* Torques of weight, springs and added potentials, which hold the arm still. */
void arm_gravity(const double q[N], double tau[N]) {
    const double rest[N] = {0.0};
    links(q, rest, rest, tau);
    added(q, rest, rest, tau);
    for (int i = 0; i < @N_ACTING@; i++)
        if (JOINTS[i].kind == SPRING) tau[JOINTS[i].joint] += JOINTS[i].value * q[JOINTS[i].joint];
}

/* Friction of every joint, to be compensated. */
void arm_friction(const double qdot[N], double tau[N]) {
    for (int k = 0; k < N; k++) tau[k] = 0.0;
    lost(qdot, tau);
    for (int i = 0; i < @N_ACTING@; i++)
        if (JOINTS[i].kind >= VISCOUS) tau[JOINTS[i].joint] += acting(&JOINTS[i], 0.0, qdot[JOINTS[i].joint], 0.0);
}
