#include "controller.h"
#include "tables.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

static void copy(double *to, const double *from, int n)
{
    memcpy(to, from, (size_t)n * sizeof *to);
}

static void fill(double *to, double value, int n)
{
    for (int i = 0; i < n; ++i) {
        to[i] = value;
    }
}

static int is_mode(int mode)
{
    return mode >= 0 && mode < QPCTRL_MODES;
}

static void bind_call(qpctrl_controller *c, qpctrl_call *call, const qpctrl_function *function,
                      double *numbers)
{
    const double **arg = c->arg + function->first_arg;
    double **res = c->res + function->first_res;
    const int *place = function->places;
    for (int i = 0; i < function->n_arg; ++i) {
        arg[i] = numbers + *place++;
    }
    for (int i = 0; i < function->n_res; ++i) {
        res[i] = numbers + *place++;
    }
    call->code = function->code;
    call->arg = arg;
    call->res = res;
    call->iw = c->iw;
    call->w = c->w;
}

/* The solver is faster there; QPCTRL_N_WORK has the room. */
static double *aligned(double *work)
{
    const size_t past = (size_t)((uintptr_t)work % 32);
    return past ? work + (32 - past) / sizeof *work : work;
}

/* Make the pointers lead into this struct. */
static void lead(qpctrl_controller *c)
{
    for (int i = 0; i < QPCTRL_MODES; ++i) {
        const qpctrl_mode *mode = &qpctrl_modes[i];
        double *numbers = c->numbers + mode->first;
        qpctrl_tick *t = &c->ticks[i];
        *t = mode->tick;
        for (int j = 0; j < mode->n_pointers; ++j) {
            double *lead = numbers + mode->pointers[j].place;
            memcpy((char *)t + mode->pointers[j].member, &lead, sizeof lead);
        }
        bind_call(c, &t->tick, &mode->functions[0], numbers);
        bind_call(c, &t->certificate, &mode->functions[1], numbers);
        bind_call(c, &t->explanation, &mode->functions[2], numbers);
        bind_call(c, &t->fallback, &mode->functions[3], numbers);
        bind_call(c, &t->limited, &mode->functions[4], numbers);
        t->work = aligned(c->work);
        t->iwork = c->iwork;
    }
    c->bound = c;
}

/* Make a struct usable that was copied, or is all zeros still. */
static void bind(qpctrl_controller *c)
{
    if (c->bound == NULL) {
        qpctrl_init(c);
    } else if (c->bound != c) {
        lead(c);
    }
}

/* References from before must not be followed when the mode is entered again. */
static void forget_references(qpctrl_controller *c, int mode)
{
    const qpctrl_mode *m = &qpctrl_modes[mode];
    for (int i = 0; i < m->n_demanded; ++i) {
        fill(c->ticks[mode].u + m->demanded[i].first, NAN, m->demanded[i].count);
    }
}

static int lacks_reference(const qpctrl_controller *c, int mode)
{
    const qpctrl_mode *m = &qpctrl_modes[mode];
    for (int i = 0; i < m->n_demanded; ++i) {
        const double *values = c->ticks[mode].u + m->demanded[i].first;
        for (int j = 0; j < m->demanded[i].count; ++j) {
            if (isnan(values[j])) {
                return 1;
            }
        }
    }
    return 0;
}

/* Take over what the last mode's tasks remember under the same names. */
static void carry(qpctrl_controller *c, int mode)
{
    const qpctrl_mode *m = &qpctrl_modes[mode];
    const qpctrl_tick *before = &c->ticks[c->mode], *t = &c->ticks[mode];
    const int front = t->nu + t->nq;
    copy(t->last, before->last, front);
    copy(t->last + front, m->x, t->n_x);
    for (int i = 0; i < m->n_carries; ++i) {
        const qpctrl_carry *kept = &m->carries[i];
        if (kept->mode == c->mode) {
            copy(t->last + front + kept->to, before->last + front + kept->from, kept->count);
        }
    }
}

/* Return 0 once the mode is entered, else why it is not. */
static int enter(qpctrl_controller *c, int mode)
{
    if (!is_mode(mode)) {
        return QPCTRL_UNKNOWN_MODE;
    }
    if (mode == c->mode && c->entered) {
        return 0;
    }
    if (lacks_reference(c, mode)) {
        return QPCTRL_NO_REFERENCE;
    }
    if (mode != c->mode) {
        carry(c, mode);
        forget_references(c, c->mode);
        c->mode = mode;
    }
    c->entered = 1;
    return 0;
}

static void keep_solution(qpctrl_controller *c, int contact_closed)
{
    const qpctrl_mode *m = &qpctrl_modes[c->mode];
    const qpctrl_tick *t = &c->ticks[c->mode];
    copy(t->last, c->numbers + m->first + m->outcome, t->nu + t->nq + t->n_x);
    c->time = t->clock[0];
    c->freeze = c->outcome == QPCTRL_LIMITED || (m->has_rows && !contact_closed);
}

static void hold(qpctrl_controller *c)
{
    const qpctrl_mode *m = &qpctrl_modes[c->mode];
    const qpctrl_tick *t = &c->ticks[c->mode];
    const int front = t->nu + t->nq, known = qpctrl_hold(t);
    double *outcome = c->numbers + m->first + m->outcome;
    if (known) {
        c->time = t->clock[0];
    }
    c->freeze = 1;
    ++c->fallback_ticks;
    copy(t->last, outcome, front); /* tasks remember what they did */
    fill(outcome + front, NAN, m->n_outcome - front);
    *t->time = t->clock[0];
    *t->damping = *t->u_mu;
}

void qpctrl_init(qpctrl_controller *c)
{
    memset(c, 0, sizeof *c);
    lead(c);
    for (int i = 0; i < QPCTRL_MODES; ++i) {
        copy(c->ticks[i].u, qpctrl_modes[i].u, c->ticks[i].n_u);
        forget_references(c, i);
    }
    c->mode = -1;
    c->outcome = QPCTRL_NOT_STARTED;
}

int qpctrl_start(qpctrl_controller *c, int mode, const double *q)
{
    return qpctrl_start_from(c, mode, q, NULL);
}

int qpctrl_start_from(qpctrl_controller *c, int mode, const double *q, const double *tau)
{
    bind(c);
    if (!is_mode(mode)) {
        return QPCTRL_UNKNOWN_MODE;
    }
    for (int i = 0; i < QPCTRL_NQ; ++i) {
        if (!isfinite(q[i])) {
            return QPCTRL_NOT_FINITE;
        }
    }
    for (int i = 0; tau && i < QPCTRL_NU; ++i) {
        if (!isfinite(tau[i])) {
            return QPCTRL_NOT_FINITE;
        }
    }
    const qpctrl_mode *m = &qpctrl_modes[mode];
    const qpctrl_tick *t = &c->ticks[mode];
    const qpctrl_call *fallback = &t->fallback;
    copy(t->fallback_q, q, t->nq);
    fill(t->fallback_v, 0.0, t->nv);
    fallback->code(fallback->arg, fallback->res, fallback->iw, fallback->w, 0);
    if (tau) {
        copy(t->last, tau, t->nu);
    } else {
        copy(t->u_tau_last, c->numbers + m->first + m->held, t->nu); /* no rate limit from nowhere */
        fallback->code(fallback->arg, fallback->res, fallback->iw, fallback->w, 0);
        copy(t->last, t->tau, t->nu);
    }
    copy(t->last + t->nu, q, t->nq);
    copy(t->last + t->nu + t->nq, m->x, t->n_x);
    for (int i = 0; i < QPCTRL_MODES; ++i) {
        forget_references(c, i);
    }
    c->mode = mode;
    c->entered = c->freeze = 0;
    c->outcome = QPCTRL_FREE;
    c->fallback_ticks = 0;
    c->time = -INFINITY;
    return 0;
}

int qpctrl_step(qpctrl_controller *c, int mode, double time, int contact_closed, const double *q,
                const double *v, double *tau)
{
    bind(c);
    if (c->mode < 0) {
        fill(tau, 0.0, QPCTRL_NU);
        return QPCTRL_NOT_STARTED;
    }
    const int refused = enter(c, mode);
    const qpctrl_tick *t = &c->ticks[c->mode];
    copy(t->q, q, t->nq);
    copy(t->v, v, t->nv);
    t->clock[0] = time;
    t->clock[1] = c->time;
    t->clock[2] = c->freeze;
    c->outcome = refused ? refused : qpctrl_solve(t);
    if (c->outcome <= QPCTRL_LIMITED) {
        keep_solution(c, contact_closed);
    } else {
        hold(c);
    }
    copy(tau, t->tau, t->nu);
    return c->outcome;
}

double *qpctrl_inputs(qpctrl_controller *c, int mode)
{
    bind(c);
    return is_mode(mode) ? c->ticks[mode].u : NULL;
}

int qpctrl_input_count(int mode)
{
    return is_mode(mode) ? qpctrl_modes[mode].tick.n_u : 0;
}

/* A number of the last step, in this struct even where it is a copy. */
static const double *at(const qpctrl_controller *c, int place)
{
    return c->numbers + qpctrl_modes[c->mode].first + place;
}

qpctrl_report qpctrl_tell(const qpctrl_controller *c)
{
    qpctrl_report report = {0};
    report.mode = c->mode;
    report.outcome = c->outcome;
    if (c->mode < 0) {
        return report;
    }
    const qpctrl_mode *m = &qpctrl_modes[c->mode];
    report.tau_qp = at(c, m->tau_qp);
    report.tau_hybrid = at(c, m->tau_hybrid);
    report.tau_textbook = at(c, m->tau_textbook);
    report.rows = m->tick.k;
    report.row_names = m->row_names;
    report.lam = at(c, m->lam);
    report.kkt = at(c, m->kkt);
    report.gaps = at(c, m->gaps);
    report.damping = *at(c, m->damping);
    if (c->outcome == QPCTRL_DEPENDENT_ROWS) { /* pivots after a vanishing one mean nothing */
        const double *pivots = at(c, m->row_pivots);
        int row = 0;
        while (row < report.rows - 1 && pivots[row] > QPCTRL_PIVOT_RATIO) {
            ++row;
        }
        report.dependent_row = m->row_names[row];
    }
    return report;
}

int qpctrl_active(const qpctrl_controller *c, qpctrl_active_limit *found, int most)
{
    if (c->mode < 0 || c->outcome != QPCTRL_LIMITED) {
        return 0;
    }
    const qpctrl_mode *m = &qpctrl_modes[c->mode];
    const double *z = at(c, m->z), *kind = at(c, m->kind);
    int count = 0;
    for (int i = 0; i < m->tick.r; ++i) {
        if (fabs(z[i]) > QPCTRL_ACTIVE_DUAL) {
            if (count < most) {
                found[count].kind = qpctrl_kinds[(int)kind[i]];
                found[count].owner = m->owners[i];
                found[count].dual = z[i];
            }
            ++count;
        }
    }
    return count;
}

const char *qpctrl_outcome_text(int outcome)
{
    const int known = outcome >= 0 && outcome <= QPCTRL_NOT_STARTED;
    return known ? qpctrl_outcomes[outcome] : "unknown outcome";
}
