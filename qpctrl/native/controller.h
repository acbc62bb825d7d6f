/* A controller with several modes, on memory that its caller owns: no allocation, no static state.
 *
 *     static qpctrl_controller c;
 *     qpctrl_init(&c);
 *     qpctrl_start(&c, mode, q);                       where the robot is, at rest
 *     every period:
 *         double *u = qpctrl_inputs(&c, mode);         write references and measurements
 *         outcome = qpctrl_step(&c, mode, time, contact_closed, q, v, tau);
 *
 * All that a controller is lies in its struct: a copy is a second controller in the same state.
 * One controller must not be used by two threads at once.
 */
#ifndef QPCTRL_CONTROLLER_H
#define QPCTRL_CONTROLLER_H

#include "modes.h"

#ifdef __cplusplus
extern "C" {
#endif

#include "tick.h"

/* Outcomes of a step: those of tick.h, and two for a call that is wrong. */
enum {
    QPCTRL_UNKNOWN_MODE = QPCTRL_NO_REFERENCE + 1, /* no such mode; held in the one before */
    QPCTRL_NOT_STARTED                             /* `start` was never called; zero torque */
};

typedef struct qpctrl_controller {
    const struct qpctrl_controller *bound; /* the place that the pointers below are made for */
    int mode;                              /* of the last step; -1 before the start */
    int entered;                           /* whether the mode was given its references */
    int freeze;                            /* whether integrators hold at the next step */
    int outcome;                           /* of the last step */
    long long fallback_ticks;              /* steps since the start that sent the fallback torque */
    double time;                           /* of the last good measurement [s] */
    qpctrl_tick ticks[QPCTRL_MODES];
    const double *arg[QPCTRL_N_ARG];
    double *res[QPCTRL_N_RES];
    double numbers[QPCTRL_N_NUMBERS];
    double w[QPCTRL_N_W];            /* room to compute in, of generated functions */
    double work[QPCTRL_N_WORK];      /* and of the solver */
    qpctrl_int iw[QPCTRL_N_IW];
    int iwork[QPCTRL_N_IWORK];
} qpctrl_controller;

/* What a step says about itself; NaN where it has no solution. */
typedef struct {
    int mode, outcome;
    const double *tau_qp;       /* (NU) torque of the QP [Nm] */
    const double *tau_hybrid;   /* (NU) of the hybrid law; of the equality-constrained QP if none */
    const double *tau_textbook; /* (NU) of the law as printed */
    int rows;                   /* k, rows of A */
    const char *const *row_names;
    const double *lam;         /* (k) contact multipliers [N, Nm], robot on environment */
    const double *kkt;         /* (4) stationarity, equality, inequality, complementarity */
    const double *gaps;        /* (4) max |dtau| / max |tau|: QP - hybrid, QP - textbook,
                                  QP - textbook + curvature, curvature */
    double damping;            /* of the inverse inertia near a singularity, else 0 [1/kg] */
    const char *dependent_row; /* row of A that depends on others, where that is the outcome */
} qpctrl_report;

/* A row of the QP that binds. */
typedef struct {
    const char *kind;  /* torque, torque-speed, torque rate, position, velocity, unilateral or
                          contact */
    const char *owner; /* the joint, the row of A, or the row of the contact limit */
    double dual;       /* positive on an upper bound, negative on a lower one */
} qpctrl_active_limit;

/* Put every input to its default and forget all else. The references of tasks that have no safe
 * default are NaN until they are written, anew whenever their mode is entered. */
void qpctrl_init(qpctrl_controller *c);

/* Hold still at `q` (NQ) in `mode`. References are to be written after this, not before.
 * Returns 0, QPCTRL_UNKNOWN_MODE or QPCTRL_NOT_FINITE; nothing is changed by the latter two. */
int qpctrl_start(qpctrl_controller *c, int mode, const double *q);

/* The same for a robot that is held by `tau` (NU) [Nm] already, from which the first step goes on.
 * A robot that floats needs it: `qpctrl_start` takes the least multipliers that carry it, whatever
 * its contacts can bear. NULL is `qpctrl_start`. */
int qpctrl_start_from(qpctrl_controller *c, int mode, const double *q, const double *tau);

/* Write the torque (NU) [Nm] of this period to `tau` and return the outcome.
 *
 * Whatever goes wrong, `tau` holds a torque to send: above QPCTRL_LIMITED the fallback, which
 * holds the arm with damping and gravity compensation.
 *   mode            what is active from now on
 *   time            of the measurement [s], later than that of the step before
 *   contact_closed  whether force can be exchanged; in a mode with constraints integrators hold
 *                   unless it is
 *   q, v            measured (NQ, NV)
 */
int qpctrl_step(qpctrl_controller *c, int mode, double time, int contact_closed, const double *q,
                const double *v, double *tau);

/* Inputs of a mode, at the places that modes.h names; they keep their values until written.
 * NULL if there is no such mode. */
double *qpctrl_inputs(qpctrl_controller *c, int mode);

/* How many inputs a mode has; 0 if there is no such mode. */
int qpctrl_input_count(int mode);

/* What the last step says about itself; its arrays hold until the next. After the start only. */
qpctrl_report qpctrl_tell(const qpctrl_controller *c);

/* Write the limits that bound at the last step, `most` at most; returns how many there are. */
int qpctrl_active(const qpctrl_controller *c, qpctrl_active_limit *found, int most);

/* The outcome in words, which are the advice. */
const char *qpctrl_outcome_text(int outcome);

extern const char *const qpctrl_mode_names[QPCTRL_MODES];
extern const char *const qpctrl_joint_names[QPCTRL_NV];
extern const char *const qpctrl_actuator_names[QPCTRL_NU];

#ifdef __cplusplus
}
#endif

#endif
