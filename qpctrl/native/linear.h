/* Linear algebra for qp.c: columns of whole lanes, and bases of what A x = 0 leaves free.
 *
 * A column of n numbers takes ld >= n doubles, a multiple of LANES; the rest are zeros. Loops over
 * lanes are vectorised as they stand: no sum is taken in another order than is written.
 */
#ifndef QPCTRL_LINEAR_H
#define QPCTRL_LINEAR_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O2") /* generated code beside it may be compiled with less; 3 times as fast */
#endif

enum { LANES = 4 };

static void assign(int n, const double *a, double *to) { memcpy(to, a, (size_t)n * sizeof *a); }
static void clear(int n, double *a) { memset(a, 0, (size_t)n * sizeof *a); }

static double dot(int n, const double *restrict a, const double *restrict b)
{
    double s[LANES] = {0};
    for (int i = 0; i < n; i += LANES)
        for (int l = 0; l < LANES; l++) s[l] += a[i + l] * b[i + l];
    return (s[0] + s[1]) + (s[2] + s[3]);
}

static void scale(int n, double a, double *x)
{
    for (int i = 0; i < n; i += LANES)
        for (int l = 0; l < LANES; l++) x[i + l] *= a;
}

/* y += a x */
static void add(int n, double a, const double *restrict x, double *restrict y)
{
    for (int i = 0; i < n; i += LANES)
        for (int l = 0; l < LANES; l++) y[i + l] += a * x[i + l];
}

/* y += sign M x, for the first n rows of M, whose columns are ld apart */
static void add_product(int n, int columns, int ld, double sign, const double *restrict M,
                        const double *restrict x, double *restrict y)
{
    for (int i = 0; i < n; i += LANES) {
        double even[LANES] = {0}, odd[LANES] = {0};
        const double *a = M + i;
        int j = 0;
        for (; j + 2 <= columns; j += 2, a += 2 * ld)
            for (int l = 0; l < LANES; l++) {
                even[l] += a[l] * x[j];
                odd[l] += a[ld + l] * x[j + 1];
            }
        if (j < columns)
            for (int l = 0; l < LANES; l++) even[l] += a[l] * x[j];
        for (int l = 0; l < LANES; l++) y[i + l] += sign * (even[l] + odd[l]);
    }
}

/* e = R^-1 d, with R upper triangular (q x q) and its columns ld apart */
static void back_substitute(int q, int ld, const double *R, const double *d, double *e)
{
    assign(q, d, e);
    for (int j = q - 1; j >= 0; j--) {
        e[j] /= R[j * ld + j];
        for (int i = 0; i < j; i++) e[i] -= R[j * ld + i] * e[j];
    }
}

/* Lay M (n x columns), whose entries are `down` and `across` apart, out in whole lanes. */
static void widen(int n, int columns, int ld, const double *M, int down, int across, double *to)
{
    for (int j = 0; j < columns; j++)
        for (int i = 0; i < ld; i++) to[j * ld + i] = i < n ? M[i * down + j * across] : 0;
}

/* The largest |a_i|, or `least` if that is larger; passes over NaN. */
static double largest_of(double least, int n, const double *a)
{
    for (int i = 0; i < n; i++) least = fabs(a[i]) > least ? fabs(a[i]) : least;
    return least;
}

static int are_finite(int n, const double *a)
{
    double s[2 * LANES] = {0}, sum = 0; /* 0 a is NaN where a is not finite */
    int i = 0;
    for (; i + 2 * LANES <= n; i += 2 * LANES)
        for (int l = 0; l < 2 * LANES; l++) s[l] += 0 * a[i + l];
    for (; i < n; i++) sum += 0 * a[i];
    for (int l = 0; l < 2 * LANES; l++) sum += s[l];
    return sum == 0;
}

/* Exchange m variables for the right sides:  A x = b  becomes  x_B + X x_F = B^-1 b.
 *
 * T (ld x m): A' on entry; then its column i is row i of X, with that of B^-1 in the places of
 * x_B. basic (m): B. is_free (ld): 1 in F, else 0. size (m): workspace. Returns 0 if rows of A
 * depend on each other. */
static int exchange(int n, int m, int ld, double *T, int *basic, double *is_free, double *size)
{
    for (int j = 0; j < ld; j++) is_free[j] = j < n;
    for (int i = 0; i < m; i++) size[i] = largest_of(0, n, T + i * ld);
    for (int i = 0; i < m; i++) {
        double *row = T + i * ld, most = 0;
        int pivot = 0;
        for (int j = 0; j < n; j++)
            if (is_free[j] * fabs(row[j]) > most) most = fabs(row[j]), pivot = j;
        if (!(most > 1e-13 * size[i])) return 0;
        const double by = 1 / row[pivot];
        row[pivot] = 1;
        scale(ld, by, row);
        for (int k = 0; k < m; k++) {
            double *other = T + k * ld;
            const double a = other[pivot];
            if (k == i || a == 0) continue;
            other[pivot] = 0;
            add(ld, -a, row, other);
        }
        basic[i] = pivot, is_free[pivot] = 0;
    }
    return 1;
}

/* From T: Y (ld x m) with A Y = 1, and J (ld x (n - m)) with A J = 0 and J'HJ = 1.
 *
 * Y has the rows of B^-1. J is the basis Z = (-X; 1), each column less what the columns before
 * have of it in the metric H. H is ld x n; HB (ld x m), Hz (ld), X (m), d (n - m) are workspace.
 * Returns 0 if H is not positive definite where A x = 0. */
static int bases(int n, int m, int ld, const double *H, const double *T, const int *basic,
                 const double *is_free, double *Y, double *J, double *HB, double *Hz, double *X,
                 double *d)
{
    clear(ld * m, Y);
    for (int i = 0; i < m; i++) {
        assign(ld, H + basic[i] * ld, HB + i * ld);
        for (int k = 0; k < m; k++) Y[k * ld + basic[i]] = T[i * ld + basic[k]];
    }
    double *z = J;
    for (int j = 0, k = 0; j < n; j++) {
        if (is_free[j] == 0) continue;
        clear(ld, z);
        z[j] = 1;
        for (int i = 0; i < m; i++) z[basic[i]] = -(X[i] = T[i * ld + j]);
        assign(ld, H + j * ld, Hz);
        add_product(ld, m, ld, -1, HB, X, Hz);
        const double before = dot(ld, z, Hz);
        for (int l = 0; l < k; l++) d[l] = dot(ld, J + l * ld, Hz);
        add_product(ld, k, ld, -1, J, d, z);
        const double left = dot(ld, z, Hz);
        if (!(left > 1e-15 * before)) return 0;
        scale(ld, 1 / sqrt(left), z);
        z += ld, k++;
    }
    return 1;
}

#endif
