/* A small dense quadratic program: its active set by a dual method, its solution to round-off.
 *
 *     min 1/2 x'Hx + g'x   s.t.  A x = b,  lb <= C x <= ub
 *
 * with Lagrangian ... + y'(A x - b) + z'(C x): z > 0 presses on an upper bound, z < 0 on a lower
 * one. Units are the caller's; they may differ from variable to variable and from row to row.
 *
 * No allocation and no state: any number of threads may solve, each with a workspace of its own.
 *
 * Sources: Goldfarb & Idnani 1983, "A numerically stable dual method for solving strictly convex
 * quadratic programs", Mathematical Programming 27, for the method; Nocedal & Wright 2006,
 * "Numerical Optimization", 15.3, for the elimination of variables.
 */
#ifndef QPCTRL_QP_H
#define QPCTRL_QP_H

#ifdef __cplusplus
extern "C" {
#endif

/* What qpctrl_qp returns. */
enum {
    QPCTRL_QP_SOLVED = 0,
    QPCTRL_QP_INFEASIBLE = 1, /* no x satisfies all rows */
    QPCTRL_QP_FAILED = 2      /* a number that is not finite, no unique minimiser, or no end */
};

/* A bound of this size is none; nor is an infinite one. */
#define QPCTRL_QP_UNBOUNDED 1e20

/* Doubles and ints of workspace for n variables, m equalities, r two-sided rows, each >= 0. What
 * is in it before and after a call has no meaning. Aligned to 32 bytes it is a tenth faster. */
int qpctrl_qp_work(int n, int m, int r);
int qpctrl_qp_iwork(int n, int m, int r);

/* Solve one problem; returns a code from above.
 *
 * In, matrices dense and column-major:
 *   H (n x n)           symmetric, both triangles; positive definite where A x = 0
 *   g (n)
 *   A (m x n), b (m)    rows of A independent
 *   C (r x n), lb, ub (r)
 *   x_eq (n), y_eq (m)  the solution without the rows of C; for `always` a guess of it, 0 is one
 * Out, apart from the inputs and from each other; without meaning unless solved:
 *   x (n), y (m), z (r) the solution: x_eq, y_eq and 0 to the bit where x_eq keeps every row, but
 *                       for `always`; else
 *                       refined until the KKT residual, each part over its largest term or 1, is
 *                       1e-14, or no refinement halves it. Where that leaves it is the caller's
 *                       to judge, but beyond 1e-6 the problem counts as failed
 *   rough_x (n)         x before refinement
 *   w, iw               workspace
 * always: whether x_eq and y_eq are refined first, in place; that factorises the problem.
 *
 * Rows may depend on each other, repeat each other, and have lb = ub. One may be violated by 1e-13
 * of the largest entry of C x, or of 1; where rows contradict each other in round-off, by 1e-10.
 */
int qpctrl_qp(int n, int m, int r, const double *H, const double *g, const double *A,
              const double *b, const double *C, const double *lb, const double *ub,
              double *x_eq, double *y_eq, double *x, double *y, double *z,
              double *rough_x, double *w, int *iw, int always);

#ifdef __cplusplus
}
#endif

#endif
