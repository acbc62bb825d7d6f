/* The dual active-set method of Goldfarb & Idnani, on what A x = b leaves free.
 *
 * J (n x f) spans A x = 0, f = n - m, and J'HJ = 1; only there must H be positive definite. In
 * x = x_eq + J u the cost is |u|^2 / 2 above that of x_eq: sought is the point nearest to u = 0.
 *
 * W is the working set. Its q rows, each with the sign that makes it an upper bound, are the
 * columns of N, mu their multipliers. J is kept rotated so that J'N = (R; 0), R triangular. Each
 * iterate is the minimiser on W, and mu >= 0; each step brings in the row that is violated most.
 */
#include "qp.h"
#include "linear.h"

#define SAME 1e-13     /* a violation, or a multiplier of the wrong sign, that is round-off */
#define IMPLIED 1e-10  /* the same of a row that depends on W, and the most that SAME may grow to */
#define PARALLEL 1e-10 /* sine of the angle in u below which a row depends on W */
#define FLAT 1e-13     /* cosine of the angle in x below which a row depends on A */
#define NOISE 1e-14    /* round-off of c'x over |c| |x| */
#define SHARP 1e-14    /* KKT residual that needs no refinement */
#define BREAKDOWN 1e-6 /* KKT residual of what is no solution */
#define REFINEMENTS 4

enum { LOWER = -1, OUTSIDE = 0, UPPER = 1 }; /* on which side a row is in W */
enum { REDUNDANT = -1 };                     /* what `admit` returns where W implies the row */

typedef struct {
    int n, m, r, f, ld, q, steps, sign; /* sign: which bound `violated` found */
    const double *g, *b, *C, *lb, *ub;
    double *H, *At, *T, *N;      /* H and A' in columns of whole lanes, A' exchanged, W */
    double *J, *Y, *R;           /* A [J Y] = [0 1] */
    double *x, *dx, *c, *rx;     /* ld: point, step, row that enters, residual */
    double *y, *ry, *d, *e, *rw; /* m, m, f, f, f */
    double *mu, *beta, *size;    /* of each row of W: multiplier, bound, |J'c| */
    double *Cx, largest;         /* r; the largest of them, or 1 */
    int *basic, *row, *state;    /* m; of each row of W: its number; r */
} Qp;

/* Put row c into W, where d = J'c and dx = J2 d2: a reflection of J2 turns d2 into (alpha; 0). */
static void append(Qp *p, double ww)
{
    const int ld = p->ld, q = p->q++;
    double *d = p->d, *J = p->J + q * ld;
    const double alpha = d[q] > 0 ? -sqrt(ww) : sqrt(ww), by = -1 / (ww - alpha * d[q]);
    assign(ld, p->c, p->N + q * ld);
    assign(q, d, p->R + q * p->f);
    p->R[q * p->f + q] = alpha;
    add(ld, -alpha, J, p->dx);
    d[q] -= alpha;
    for (int k = q; k < p->f; k++, J += ld) add(ld, by * d[k], p->dx, J);
}

/* Take row l out of W; rotations of J make R triangular again. */
static void drop(Qp *p, int l)
{
    const int ld = p->ld, f = p->f, q = --p->q;
    p->state[p->row[l]] = OUTSIDE;
    for (int j = l; j < q; j++) {
        assign(j + 2, p->R + (j + 1) * f, p->R + j * f);
        assign(ld, p->N + (j + 1) * ld, p->N + j * ld);
        p->mu[j] = p->mu[j + 1], p->beta[j] = p->beta[j + 1];
        p->size[j] = p->size[j + 1], p->row[j] = p->row[j + 1];
    }
    for (int j = l; j < q; j++) {
        double *R = p->R + j * f + j, *left = p->J + j * ld, *right = left + ld;
        const double length = sqrt(R[0] * R[0] + R[1] * R[1]), c = R[0] / length, s = R[1] / length;
        for (int k = j; k < q; k++, R += f) {
            const double up = R[0], low = R[1];
            R[0] = c * up + s * low, R[1] = c * low - s * up;
        }
        for (int i = 0; i < ld; i++) {
            const double a = left[i], b = right[i];
            left[i] = c * a + s * b, right[i] = c * b - s * a;
        }
    }
}

/* The row of W whose multiplier is the first to fall to 0 along -e, at *t; or -1. */
static int blocking(const Qp *p, double size, double *t)
{
    int first = -1;
    *t = INFINITY;
    for (int j = 0; j < p->q; j++)
        if (p->e[j] * p->size[j] > PARALLEL * size && p->mu[j] / p->e[j] < *t)
            *t = p->mu[j] / p->e[j], first = j;
    return first;
}

/* The row outside W that is violated most, or -1. */
static int violated(Qp *p, double same)
{
    int found = -1, i = p->r / LANES * LANES;
    double most = 0;
    clear(p->r, p->Cx);
    add_product(i, p->n, p->r, 1, p->C, p->x, p->Cx);
    for (; i < p->r; i++)
        for (int j = 0; j < p->n; j++) p->Cx[i] += p->C[i + j * p->r] * p->x[j];
    p->largest = largest_of(1, p->r, p->Cx);
    for (i = 0; i < p->r; i++) {
        const double above = p->Cx[i] - p->ub[i], below = p->lb[i] - p->Cx[i];
        const double excess = above > below ? above : below;
        if (p->state[i] != OUTSIDE || excess <= same * p->largest || excess <= most) continue;
        most = excess, found = i, p->sign = above > below ? UPPER : LOWER;
    }
    return found;
}

/* Residuals of the KKT conditions on W, from the data; returns the largest, each part over its
 * largest term or 1. */
static double residual(Qp *p)
{
    const int n = p->n, ld = p->ld, columns[] = {n, p->m, p->q};
    const double *const M[] = {p->H, p->At, p->N}, *const by[] = {p->x, p->y, p->mu};
    double term = largest_of(1, n, p->g), worst = 0;
    for (int j = 0; j < n; j++) p->rx[j] = -p->g[j];
    for (int k = 0; k < 3; k++) {
        clear(ld, p->c);
        add_product(ld, columns[k], ld, 1, M[k], by[k], p->c);
        term = largest_of(term, n, p->c);
        add(ld, -1, p->c, p->rx);
    }
    for (int i = 0; i < p->m; i++) p->ry[i] = p->b[i] - dot(ld, p->At + i * ld, p->x);
    for (int j = 0; j < p->q; j++) {
        p->rw[j] = p->beta[j] - dot(ld, p->N + j * ld, p->x);
        worst = fmax(worst, fabs(p->rw[j]) / fmax(1, fabs(p->beta[j])));
    }
    worst = fmax(worst, largest_of(0, p->m, p->ry) / largest_of(1, p->m, p->b));
    return are_finite(n, p->rx) ? fmax(worst, largest_of(0, n, p->rx) / term) : NAN;
}

/* Solve  [H A' N; A 0 0; N' 0 0] (dx, dy, dmu) = (rx, ry, rw)  and add the solution. */
static void correct(Qp *p)
{
    const int ld = p->ld, q = p->q;
    double *rest = p->c, *u = p->d;
    clear(ld, p->dx);
    add_product(ld, p->m, ld, 1, p->Y, p->ry, p->dx);
    assign(ld, p->rx, rest);
    add_product(ld, p->n, ld, -1, p->H, p->dx, rest);
    for (int k = 0; k < p->f; k++) u[k] = dot(ld, p->J + k * ld, rest);
    for (int j = 0; j < q; j++) { /* R'u1 = rw - N'Y ry,  R dmu = J1'rest - u1 */
        double left = p->rw[j] - dot(ld, p->N + j * ld, p->dx);
        for (int i = 0; i < j; i++) left -= p->R[j * p->f + i] * u[i];
        left /= p->R[j * p->f + j];
        p->rw[j] = u[j] - left, u[j] = left;
    }
    back_substitute(q, p->f, p->R, p->rw, p->e);
    add_product(ld, p->f, ld, 1, p->J, u, p->dx);
    assign(ld, p->rx, rest);
    add_product(ld, p->n, ld, -1, p->H, p->dx, rest);
    add_product(ld, q, ld, -1, p->N, p->e, rest);
    for (int i = 0; i < p->m; i++) p->y[i] += dot(ld, p->Y + i * ld, rest);
    for (int j = 0; j < q; j++) p->mu[j] += p->e[j];
    add(ld, 1, p->dx, p->x);
}

/* Bring row i into W, on the side found; rows whose multiplier falls to 0 on the way leave W. */
static int admit(Qp *p, int i)
{
    const int f = p->f, ld = p->ld, sign = p->sign;
    const double beta = sign > 0 ? p->ub[i] : -p->lb[i];
    double mu = 0, t1, t2;
    if (beta <= -QPCTRL_QP_UNBOUNDED) return QPCTRL_QP_INFEASIBLE;
    for (int j = 0; j < p->n; j++) p->c[j] = sign * p->C[i + j * p->r];
    while (p->steps-- > 0) {
        const int q = p->q;
        double vv = 0, ww = 0; /* squares of the row in u, and of what of it is not in W */
        for (int k = 0; k < f; k++) {
            p->d[k] = dot(ld, p->J + k * ld, p->c);
            vv += p->d[k] * p->d[k];
            if (k >= q) ww += p->d[k] * p->d[k];
        }
        clear(ld, p->dx);
        add_product(ld, f - q, ld, 1, p->J + q * ld, p->d + q, p->dx);
        const double excess = dot(ld, p->c, p->x) - beta, length = sqrt(dot(ld, p->c, p->c));
        const double flat = FLAT * length * sqrt(dot(ld, p->dx, p->dx));
        t2 = ww > PARALLEL * PARALLEL * vv && ww > flat ? excess / ww : INFINITY;
        back_substitute(p->q, p->f, p->R, p->d, p->e);
        const int l = blocking(p, sqrt(vv), &t1);
        const double t = fmin(t1, t2);
        const double noise = fmin(NOISE * length * sqrt(dot(ld, p->x, p->x)), IMPLIED * p->largest);
        if (t2 == INFINITY && excess <= noise) return REDUNDANT;
        if (t == INFINITY) { /* judged at the point that is on W to round-off */
            residual(p), clear(ld, p->rx), correct(p), violated(p, SAME);
            const double left = sign * p->Cx[i] - beta;
            return left > IMPLIED * p->largest ? QPCTRL_QP_INFEASIBLE : REDUNDANT;
        }
        for (int j = 0; j < q; j++) p->mu[j] -= t * p->e[j];
        mu += t;
        if (t2 < INFINITY) add(ld, -t, p->dx, p->x);
        if (t2 <= t1) {
            p->mu[q] = mu, p->beta[q] = beta, p->size[q] = sqrt(vv), p->row[q] = i;
            p->state[i] = sign;
            append(p, ww);
            return QPCTRL_QP_SOLVED;
        }
        drop(p, l);
    }
    return QPCTRL_QP_FAILED;
}

/* Refine the point on W; returns its residual. */
static double refine(Qp *p)
{
    double before = INFINITY, error = residual(p);
    for (int i = 0; i < REFINEMENTS && error > SHARP && error < before / 2; i++)
        before = error, correct(p), error = residual(p);
    return error;
}

/* The row of W whose multiplier has the wrong sign beyond round-off, or -1. */
static int pulling(Qp *p, double same)
{
    double mu;
    for (int j = 0; j < p->q; j++) p->e[j] = 1;
    const int least = blocking(p, 0, &mu);
    return mu < -same * largest_of(1, p->q, p->mu) ? least : -1;
}

/* From the violated row i on, or from none, with the last residual. What refinement uncovers is
 * looked for less closely every time. */
static int solve(Qp *p, int i, double error, double *rough_x)
{
    double same = SAME;
    while (i >= 0) {
        int code;
        do {
            code = admit(p, i);
            if (code > 0) return code;
        } while (code != REDUNDANT && (i = violated(p, same)) >= 0);
        for (int j = 0; j < p->n; j++) rough_x[j] = p->x[j];
        error = refine(p);
        for (int j = pulling(p, same); j >= 0; j = pulling(p, same)) {
            drop(p, j);
            error = refine(p);
        }
        same = fmin(10 * same, IMPLIED);
        i = violated(p, same);
    }
    return error <= BREAKDOWN ? QPCTRL_QP_SOLVED : QPCTRL_QP_FAILED;
}

/* Lay arrays out in w, if there is one; returns how many doubles they take. */
static int lay_out(Qp *p, int n, int m, int r, double *w)
{
    const int f = n > m ? n - m : 0, ld = (n + LANES - 1) / LANES * LANES;
    double **const array[] = {&p->H, &p->N,  &p->At, &p->T,  &p->Y,    &p->J,    &p->R,
                              &p->x, &p->dx, &p->c,  &p->rx, &p->d,    &p->e,    &p->rw,
                              &p->mu, &p->beta, &p->size, &p->y, &p->ry, &p->Cx};
    const int size[] = {ld * n, ld * n, ld * m, ld * m, ld * m, ld * f, f * f, ld, ld, ld,
                        ld, f, f, f, f, f, f, m, m, r};
    int used = 0;
    for (size_t i = 0; i < sizeof size / sizeof *size; used += size[i++])
        if (w) *array[i] = w + used;
    p->n = n, p->m = m, p->r = r, p->f = f, p->ld = ld, p->q = 0, p->steps = 10 * (n + r);
    return used;
}

int qpctrl_qp_work(int n, int m, int r) { return lay_out(&(Qp){0}, n, m, r, NULL) + 1; }
int qpctrl_qp_iwork(int n, int m, int r) { return n + m + r + 1; }

int qpctrl_qp(int n, int m, int r, const double *H, const double *g, const double *A,
              const double *b, const double *C, const double *lb, const double *ub,
              double *x_eq, double *y_eq, double *x, double *y, double *z,
              double *rough_x, double *w, int *iw, int always)
{
    Qp p = {.g = g, .b = b, .C = C, .lb = lb, .ub = ub, .basic = iw, .row = iw + m};
    int code = QPCTRL_QP_SOLVED, crossed = 0, unknown = 0;
    lay_out(&p, n, m, r, w);
    p.state = p.row + n;
    widen(n, 1, p.ld, x_eq, 1, 0, p.x);
    for (int j = 0; j < n; j++) rough_x[j] = x_eq[j];
    for (int i = 0; i < m; i++) p.y[i] = y_eq[i];
    for (int i = 0; i < r; i++) {
        z[i] = 0, p.state[i] = OUTSIDE;
        crossed |= lb[i] > ub[i], unknown |= isnan(lb[i]) || isnan(ub[i]);
    }
    const int worst = violated(&p, SAME);
    if (unknown || !are_finite(n, x_eq) || !are_finite(m, y_eq) || !are_finite(r, p.Cx) ||
        !are_finite(n, g) || !are_finite(m, b) || !are_finite(n * n, H) || !are_finite(m * n, A))
        return QPCTRL_QP_FAILED;
    if (crossed) return QPCTRL_QP_INFEASIBLE;
    if (worst >= 0 || always) {
        widen(n, n, p.ld, H, 1, n, p.H);
        widen(n, m, p.ld, A, m, 1, p.At);
        assign(p.ld * m, p.At, p.T);
        clear(p.ld, p.c), clear(p.ld, p.rx);
        if (!exchange(n, m, p.ld, p.T, p.basic, p.dx, p.ry) ||
            !bases(n, m, p.ld, p.H, p.T, p.basic, p.dx, p.Y, p.J, p.N, p.c, p.ry, p.d))
            return QPCTRL_QP_FAILED;
        double error = 0;
        int first = worst;
        if (always) {
            error = refine(&p), first = violated(&p, SAME);
            for (int j = 0; j < n; j++) x_eq[j] = p.x[j];
            for (int i = 0; i < m; i++) y_eq[i] = p.y[i];
        }
        code = solve(&p, first, error, rough_x);
        for (int j = 0; j < p.q; j++) z[p.row[j]] = p.state[p.row[j]] * fmax(p.mu[j], 0);
    }
    for (int j = 0; j < n; j++) x[j] = p.x[j];
    for (int i = 0; i < m; i++) y[i] = p.y[i];
    return code;
}
