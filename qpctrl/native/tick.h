/* One control tick on caller-owned buffers: no allocation, no static state, one call.
 *
 * Every formula comes from the generated functions; here is only what they cannot express: the
 * order of the steps, the active set (qp.h), and what to send when there is no solution.
 */
#ifndef QPCTRL_TICK_H
#define QPCTRL_TICK_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "a tick must see what is no number: compile without -ffast-math and -ffinite-math-only"
#endif

typedef long long qpctrl_int;
typedef int (*qpctrl_code)(const double **arg, double **res, qpctrl_int *iw, double *w, int mem);

/* A generated function with its arguments, results and work space. */
typedef struct {
    qpctrl_code code;
    const double **arg;
    double **res;
    qpctrl_int *iw;
    double *w;
} qpctrl_call;

/* Outcome of a tick; the first two send the solution, the others the fallback torque. */
enum {
    QPCTRL_FREE,           /* solved, no limit active */
    QPCTRL_LIMITED,        /* solved, a limit is active */
    QPCTRL_INACCURATE,     /* KKT residual above the tolerance, or no end of iterations */
    QPCTRL_INFEASIBLE,     /* no torque within the limits satisfies the constraint */
    QPCTRL_NOT_FINITE,     /* a measurement or an input is no number */
    QPCTRL_STALE,          /* the measurement is not newer than the last one */
    QPCTRL_DEPENDENT_ROWS, /* rows of A depend on each other */
    QPCTRL_NO_REFERENCE    /* a task was never given what it shall follow (export only) */
};

/* Whose torque is sent. */
enum { QPCTRL_LAW_QP, QPCTRL_LAW_HYBRID, QPCTRL_LAW_TEXTBOOK };

typedef struct {
    int nq, nv, nu;  /* configuration, velocities, torques */
    int n, m, r, k;  /* variables, equalities, inequalities of the QP; multipliers */
    int n_u, n_x;    /* packed inputs, packed memory of the tasks */
    int law;
    int searched;    /* whether the minimiser without inequalities is to be searched for */
    double tolerance;   /* largest accepted KKT residual */
    double active_dual; /* a row counts as active when its dual is larger than this */
    qpctrl_call tick, certificate, explanation, fallback, limited;

    /* What goes in. */
    double *clock; /* time of this and of the last good measurement [s]; 1 if integrators hold */
    double *q, *v; /* (nq, nv) measured */
    double *last;  /* torque sent (nu), believed configuration (nq), memory of the tasks (n_x) */
    double *u;     /* (n_u) inputs; some of them: */
    double *u_mu, *u_freeze, *u_tau_last;

    /* The QP, results of `tick`; column-major. Where it is searched for, x_eq and y_eq come in as
     * zeros, and tau_hybrid and tau_textbook as well. */
    double *H, *g, *A, *b, *C, *lb, *ub, *t, *x_eq, *y_eq;
    double *damping_wanted, *dependent;
    double *point_x, *point_y, *point_z; /* (n, m, r) the solution */
    double *rough;                       /* (n) the solver's answer before its refinement */

    /* What comes out. */
    double *tau;                             /* (nu) torque to send */
    double *tau_qp, *tau_solver;             /* (nu) */
    double *tau_hybrid, *tau_textbook;       /* (nu) */
    double *time, *q_out;                    /* (1, nq) */
    double *lam, *kkt, *z;                   /* (k, 4, r) */
    double *damping;                         /* (1) */

    double *fallback_q, *fallback_v; /* (nq, nv) arguments of `fallback` */
    double *limited_tau, *limited_v; /* (nu, nv) arguments of `limited` */

    double *work;
    int *iwork;
} qpctrl_tick;

/* Solve the tick whose inputs are loaded; nothing is sent where the outcome is not a solution. */
int qpctrl_solve(const qpctrl_tick *t);

/* Put the fallback torque into `tau`, from the newest state that can be believed.
 * Returns 1 if the measured configuration is believed, which then is in `q_out`; else 0, and
 * the last one is in `q_out`. */
int qpctrl_hold(const qpctrl_tick *t);

#endif
