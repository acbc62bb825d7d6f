/* What a controller knows about its modes: constant tables, written by the export. */
#ifndef QPCTRL_TABLES_H
#define QPCTRL_TABLES_H

#include "controller.h"

#include <stddef.h>

/* A generated function, and where the numbers are that it reads and writes. */
typedef struct {
    qpctrl_code code;
    int first_arg, first_res; /* its pointers among those of the controller */
    int n_arg, n_res;
    const int *places; /* of the arguments, then of the results */
} qpctrl_function;

/* A member of qpctrl_tick that is a pointer, and where it leads. */
typedef struct {
    size_t member;
    int place;
} qpctrl_pointer;

/* Memory of tasks that is taken over from another mode. */
typedef struct {
    int mode, from, to, count;
} qpctrl_carry;

typedef struct {
    int first, count;
} qpctrl_span;

typedef struct {
    qpctrl_tick tick; /* its sizes; the pointers are set in the controller's own */
    int first;        /* where the numbers of the mode begin; the places below count from there */
    qpctrl_function functions[5]; /* tick, certificate, explanation, fallback, limited */
    const qpctrl_pointer *pointers;
    const qpctrl_carry *carries;
    const qpctrl_span *demanded; /* inputs that must be written before the mode is entered */
    int n_pointers, n_carries, n_demanded;
    const double *u, *x; /* defaults of the inputs and of the tasks' memory */
    int has_rows;        /* whether there are constraints, so that integrators need a contact */
    int held;            /* torque that holds still, without its limits (nu) */
    int outcome, n_outcome; /* all that a tick leaves behind; in front what the next one needs */
    int tau_qp, tau_hybrid, tau_textbook, lam, kkt, gaps, z, kind, damping, row_pivots;
    const char *const *row_names; /* of A */
    const char *const *owners;    /* of the inequalities of the QP */
} qpctrl_mode;

extern const qpctrl_mode qpctrl_modes[QPCTRL_MODES];
extern const char *const qpctrl_kinds[];
extern const char *const qpctrl_outcomes[];

#endif
