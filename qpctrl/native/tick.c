#include "tick.h"
#include "qp.h"

#include <math.h>
#include <string.h>

/* KKT residual below which the minimiser without inequalities is taken as it is. */
#define WELL_POLISHED 1e-12

static void copy(double *to, const double *from, int n)
{
    memcpy(to, from, (size_t)n * sizeof *to);
}

static int all_finite(const double *values, int n)
{
    double sum[4] = {0.0}; /* infinities and NaN stay when multiplied by 0 and added */
    int i = 0;
    for (; i + 4 <= n; i += 4) { /* four sums that do not wait for each other */
        for (int j = 0; j < 4; ++j) {
            sum[j] += 0.0 * values[i + j];
        }
    }
    for (; i < n; ++i) {
        sum[0] += 0.0 * values[i];
    }
    return sum[0] + sum[1] + sum[2] + sum[3] == 0.0;
}

static double largest(const double *values, int n)
{
    double most = 0.0;
    for (int i = 0; i < n; ++i) {
        const double size = fabs(values[i]);
        most = size > most ? size : most;
    }
    return most;
}

static void evaluate(const qpctrl_call *call)
{
    call->code(call->arg, call->res, call->iw, call->w, 0);
}

/* tau = T x + t, where T is the first nu rows of C. */
static void torque_of(const qpctrl_tick *t, const double *x, double *tau)
{
    copy(tau, t->t, t->nu);
    for (int j = 0; j < t->n; ++j) {
        const double *column = t->C + (size_t)j * (size_t)t->r;
        for (int i = 0; i < t->nu; ++i) {
            tau[i] += column[i] * x[j];
        }
    }
}

static void keep_within_limits(const qpctrl_tick *t, const double *tau, const double *v)
{
    copy(t->limited_tau, tau, t->nu);
    copy(t->limited_v, v, t->nv);
    evaluate(&t->limited); /* result: tau */
}

/* Near a singularity the tick is evaluated again, with a damped inertia. */
static void evaluate_tick(const qpctrl_tick *t)
{
    *t->u_mu = 0.0;
    evaluate(&t->tick);
    *t->damping = *t->damping_wanted;
    if (*t->damping > 0.0) {
        *t->u_mu = *t->damping;
        evaluate(&t->tick);
    }
}

static int accurate(const qpctrl_tick *t)
{
    return all_finite(t->point_x, t->n) && all_finite(t->point_y, t->m) && all_finite(t->point_z, t->r) &&
           all_finite(t->tau_qp, t->nu) && all_finite(t->kkt, 4) && largest(t->kkt, 4) <= t->tolerance;
}

/* Outcome of the QP, refined at once or not; results: the point, tau_qp, kkt, gaps. */
static int solve_qp(const qpctrl_tick *t, int refined)
{
    const int found = qpctrl_qp(t->n, t->m, t->r, t->H, t->g, t->A, t->b, t->C, t->lb, t->ub,
                                t->x_eq, t->y_eq, t->point_x, t->point_y, t->point_z, t->rough,
                                t->work, t->iwork, refined);
    if (found == QPCTRL_QP_SOLVED) {
        if (t->searched) {
            if (largest(t->point_z, t->r) == 0.0) {
                copy(t->rough, t->point_x, t->n);
            }
            torque_of(t, t->x_eq, t->tau_hybrid);
            copy(t->tau_textbook, t->tau_hybrid, t->nu);
        }
        evaluate(&t->certificate);
        return QPCTRL_FREE;
    }
    return found == QPCTRL_QP_INFEASIBLE ? QPCTRL_INFEASIBLE : QPCTRL_INACCURATE;
}

/* The minimiser without inequalities comes from the graph; where it is inexact it is refined. */
static int solve_and_certify(const qpctrl_tick *t)
{
    int failed = solve_qp(t, t->searched);
    if (!failed && !t->searched && largest(t->point_z, t->r) == 0.0 && !(largest(t->kkt, 4) <= WELL_POLISHED)) {
        failed = solve_qp(t, 1);
    }
    return failed ? failed : accurate(t) ? QPCTRL_FREE : QPCTRL_INACCURATE;
}

int qpctrl_solve(const qpctrl_tick *t)
{
    if (!(all_finite(t->q, t->nq) && all_finite(t->v, t->nv) && all_finite(t->clock, 1))) {
        return QPCTRL_NOT_FINITE;
    }
    if (t->clock[0] <= t->clock[1]) {
        return QPCTRL_STALE;
    }
    copy(t->u_tau_last, t->last, t->nu);
    *t->u_freeze = t->clock[2];
    if (!all_finite(t->u, t->n_u)) {
        return QPCTRL_NOT_FINITE;
    }
    evaluate_tick(t);
    if (*t->dependent != 0.0) {
        return QPCTRL_DEPENDENT_ROWS;
    }
    const int failed = solve_and_certify(t);
    if (failed) {
        return failed;
    }
    torque_of(t, t->rough, t->tau_solver);
    copy(t->lam, t->point_x + (t->n - t->k), t->k);
    copy(t->z, t->point_z, t->r);
    copy(t->q_out, t->q, t->nq);
    *t->time = t->clock[0];
    if (t->law == QPCTRL_LAW_QP) {
        copy(t->tau, t->tau_qp, t->nu);
    } else {
        keep_within_limits(t, t->law == QPCTRL_LAW_HYBRID ? t->tau_hybrid : t->tau_textbook, t->v);
    }
    if (largest(t->z, t->r) > t->active_dual) {
        evaluate(&t->explanation); /* results: what binds, what gives way */
        return QPCTRL_LIMITED;
    }
    return QPCTRL_FREE;
}

int qpctrl_hold(const qpctrl_tick *t)
{
    const double *const q_last = t->last + t->nu;
    const double elapsed = t->clock[0] - t->clock[1];
    const int known = elapsed > 0.0 && all_finite(t->clock, 1) && all_finite(t->q, t->nq);
    copy(t->u_tau_last, t->last, t->nu);
    copy(t->fallback_q, known ? t->q : q_last, t->nq);
    copy(t->q_out, t->fallback_q, t->nq);
    for (int i = 0; i < t->nv; ++i) { /* no damping along a velocity nobody knows */
        t->fallback_v[i] = known && t->nq == t->nv ? (t->q[i] - q_last[i]) / elapsed : 0.0;
    }
    if (known && all_finite(t->v, t->nv)) {
        copy(t->fallback_v, t->v, t->nv);
    }
    evaluate(&t->fallback); /* result: tau */
    return known;
}
