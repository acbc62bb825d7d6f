/* Replay a recorded run: the same measurements and inputs, the controller's own memory.
 *
 *     replay recording.bin
 *
 * Exit code 0 if the torques are those that were recorded, 1 if not, 2 if it cannot be read.
 *
 * A recording holds nothing but doubles, in the byte order of the machine that wrote it:
 *     1234.5, version 2, NQ, NV, NU, number of modes
 *     at the start: mode, number of its inputs, these inputs, q (NQ), tau (NU) that holds there
 *     each step:    mode, time, contact closed (0 or 1), fallback (0 or 1), q (NQ), v (NV),
 *                   tau (NU), number of spans, and each span of inputs that changed:
 *                   its first input, its length, the inputs
 */
#define _POSIX_C_SOURCE 199309L

#include "qpctrl.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define MARK 1234.5
#define VERSION 2.0
#define ACCURACY 1e-10 /* of the torques, relative to the largest */

typedef struct {
    const double *next, *end;
} reader;

static void refuse(const char *why)
{
    fprintf(stderr, "replay: %s\n", why);
    exit(2);
}

static const double *take(reader *from, double count)
{
    const double *taken = from->next;
    if (!(count >= 0.0 && count <= (double)(from->end - from->next))) {
        refuse("the recording is cut short");
    }
    from->next += (long)count;
    return taken;
}

static int whole(reader *from, int below, const char *what)
{
    const double value = *take(from, 1);
    if (!(value >= 0.0 && value < below && value == floor(value))) {
        refuse(what);
    }
    return (int)value;
}

static void set_inputs(reader *from, double *u, int n_u)
{
    const int first = whole(from, n_u, "no such input; is it a recording of this controller?");
    const int count = whole(from, n_u - first + 1, "more inputs than there are");
    const double *values = take(from, count);
    for (int i = 0; i < count; ++i) {
        u[first + i] = values[i];
    }
}

static double *read_file(const char *name, long *count)
{
    FILE *file = fopen(name, "rb");
    double *values = NULL;
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        refuse("the recording cannot be read");
    }
    *count = ftell(file) / (long)sizeof *values;
    rewind(file);
    if (*count > 0) {
        values = malloc((size_t)*count * sizeof *values);
    }
    if (values == NULL || fread(values, sizeof *values, (size_t)*count, file) != (size_t)*count) {
        refuse("the recording cannot be read");
    }
    fclose(file);
    return values;
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void check_head(reader *from)
{
    const double *head = take(from, 6);
    if (head[0] != MARK || head[1] != VERSION) {
        refuse("not a recording, or one of another version or byte order");
    }
    if (head[2] != QPCTRL_NQ || head[3] != QPCTRL_NV || head[4] != QPCTRL_NU ||
        head[5] != QPCTRL_MODES) {
        refuse("a recording of another controller");
    }
}

static void start(reader *from, qpctrl_controller *c)
{
    const int mode = whole(from, QPCTRL_MODES, "no such mode");
    const int n_u = qpctrl_input_count(mode);
    double *u = qpctrl_inputs(c, mode);
    if (whole(from, n_u + 1, "more inputs than there are") != n_u) {
        refuse("fewer inputs than there are");
    }
    const double *values = take(from, n_u);
    for (int i = 0; i < n_u; ++i) {
        u[i] = values[i];
    }
    const double *q = take(from, QPCTRL_NQ), *tau = take(from, QPCTRL_NU);
    if (qpctrl_start_from(c, mode, q, QPCTRL_NQ == QPCTRL_NV ? NULL : tau) != 0) {
        refuse("the controller cannot start there");
    }
}

/* What a replay found. */
typedef struct {
    long ticks, fallbacks, other_outcomes;
    double largest, worst; /* max |tau|, max |tau - recorded| [Nm] */
} verdict;

/* Replay one step and return how long it took [us]. */
static double step(reader *from, qpctrl_controller *c, verdict *found)
{
    double tau[QPCTRL_NU];
    const int mode = whole(from, QPCTRL_MODES, "no such mode");
    const double time = *take(from, 1);
    const int closed = whole(from, 2, "contact closed is neither 0 nor 1");
    const int fallback = whole(from, 2, "fallback is neither 0 nor 1");
    const double *q = take(from, QPCTRL_NQ), *v = take(from, QPCTRL_NV);
    const double *recorded = take(from, QPCTRL_NU);
    const int n_u = qpctrl_input_count(mode);
    for (int spans = whole(from, n_u + 1, "more spans than inputs"); spans > 0; --spans) {
        set_inputs(from, qpctrl_inputs(c, mode), n_u);
    }
    const double started = now();
    const int outcome = qpctrl_step(c, mode, time, closed, q, v, tau);
    const double took = now() - started;
    for (int i = 0; i < QPCTRL_NU; ++i) {
        const double gap = fabs(tau[i] - recorded[i]);
        found->largest = fmax(found->largest, fabs(recorded[i]));
        found->worst = isfinite(gap) ? fmax(found->worst, gap) : INFINITY;
    }
    found->other_outcomes += (outcome > QPCTRL_LIMITED) != fallback;
    found->fallbacks += fallback;
    ++found->ticks;
    return took;
}

int main(int argc, char **argv)
{
    static qpctrl_controller c;
    verdict found = {0};
    long count;
    if (argc != 2) {
        refuse("usage: replay recording.bin");
    }
    double *values = read_file(argv[1], &count);
    reader from = {values, values + count};
    double *took = malloc((size_t)count * sizeof *took); /* a step has more than one number */
    if (took == NULL) {
        refuse("no memory");
    }
    qpctrl_init(&c);
    check_head(&from);
    start(&from, &c);
    while (from.next < from.end) {
        const double us = step(&from, &c, &found);
        took[found.ticks - 1] = us;
    }
    if (found.ticks == 0) {
        refuse("the recording has no steps");
    }
    qsort(took, (size_t)found.ticks, sizeof *took, ascending);
    const double gap = found.worst / fmax(found.largest, 1e-9);
    const int same = gap <= ACCURACY && found.other_outcomes == 0;
    printf("ticks=%ld fallback_ticks=%ld other_outcomes=%ld gap=%.3g tick_us_median=%.2f "
           "tick_us_p99=%.2f\n",
           found.ticks, found.fallbacks, found.other_outcomes, gap, took[found.ticks / 2],
           took[found.ticks * 99 / 100]);
    printf("%s: max |tau - recorded| is %.1e of max |tau|, allowed %.0e\n",
           same ? "same torques" : "OTHER TORQUES", gap, ACCURACY);
    free(took);
    free(values);
    return same ? 0 : 1;
}
