/* Marches many vehicles of one structure, each over its own cycle, on threads of its own.  Included after march.c, and where there
   are lanes after the step in lanes.

   HS_SUM, HS_MAX, HS_MIN, HS_LAST, HS_SEEN and HS_KEPT say how many outputs are integrated, have their maximum and minimum taken, are
   looked at last, are looked at once at some time, and are kept as histories; at_sum, at_max and so on say which.  HS_BEGIN and at_begin
   are states that are looked at before the first step. */

#include <limits.h>
#include <pthread.h>

#define HS_FOUND (HS_SUM + HS_MAX + HS_MIN + HS_LAST + HS_BEGIN + HS_SEEN)

typedef struct {
  long n;
  const double *dt, *v, *grade, *key_on;
  long n_grade;
  const double *grade_distance, *grade_value;
  const long *at; /* the step in which each of at_seen is looked at, rising; one that there is not, never */
} trace;

typedef struct {
  long runs, next; /* how many, and the first that no thread has taken */
  const int *order; /* which run is taken first, second and so on */
  const trace *traces;
  const int *trace_of;    /* which trace each run has */
  const double *p;        /* parameters, HS_NP a run */
  const double *x;        /* start values of the states `x_of`, `n_x` a run; the others start as the parameters say */
  const int *x_of;
  long n_x;
  double *found;          /* HS_FOUND a run */
  double *history;        /* `rows` times HS_KEPT a run */
  long rows;
  int *lost;              /* the step by which a number was lost, counted from 1; 0 where none was */
  int *unsolved;          /* searches without success */
  int mode;
} batch;

#ifdef HS_LANES
#include "march_lanes.h"
#else

#define HS_LANES 1

static void march_some(const batch *b, long at) {
  const long run = b->order[at];
  const trace *c = b->traces + b->trace_of[run];
  const double *p = b->p + run * HS_NP;
  double state[2][HS_NX], u[HS_NU], q[HS_NQ], y[HS_NY];
  double *now = state[0], *next = state[1];
  double *sum = b->found + run * HS_FOUND, *max = sum + HS_SUM, *min = max + HS_MAX, *last = min + HS_MIN;
  double *begin = last + HS_LAST, *seen = begin + HS_BEGIN;
  double *kept = b->history + run * b->rows * HS_KEPT;
  trial t = first_trial(p, q, u);
  long k, s = 0;
  hs_start(p, now);
  for (long i = 0; i < b->n_x; ++i) now[b->x_of[i]] = b->x[run * b->n_x + i];
  t.failed = hs_prepare(p, q) | hs_lost(now, HS_NX);
  for (int i = 0; i < HS_SUM; ++i) sum[i] = 0;
  for (int i = 0; i < HS_MAX; ++i) max[i] = -HUGE_VAL;
  for (int i = 0; i < HS_MIN; ++i) min[i] = HUGE_VAL;
  for (int i = 0; i < HS_BEGIN; ++i) begin[i] = now[at_begin[i]];
  for (int i = 0; i < HS_SEEN; ++i) seen[i] = NAN;
  for (k = 0; k < c->n; ++k) {
    u[0] = c->v[k];
    u[1] = c->n_grade ? grade_at(now[HS_X_DISTANCE], c->n_grade, c->grade_distance, c->grade_value) : c->grade[k];
    u[2] = c->key_on[k];
    u[3] = c->dt[k];
    u[4] = 0;
    advance(&t, now, next, y, b->mode);
    if (k % 16 == 15 || k == c->n - 1) t.failed |= hs_lost(next, HS_NX);
    if (t.failed) break;
    for (int i = 0; i < HS_SUM; ++i) sum[i] += y[at_sum[i]] * c->dt[k];
    for (int i = 0; i < HS_MAX; ++i) max[i] = y[at_max[i]] > max[i] ? y[at_max[i]] : max[i];
    for (int i = 0; i < HS_MIN; ++i) min[i] = y[at_min[i]] < min[i] ? y[at_min[i]] : min[i];
    for (; s < HS_SEEN && c->at[s] <= k; ++s) seen[s] = c->at[s] == k ? y[at_seen[s]] : NAN;
    for (int i = 0; i < HS_KEPT; ++i) kept[k * HS_KEPT + i] = y[at_kept[i]];
    double *swap = now; now = next; next = swap;
  }
  for (int i = 0; i < HS_LAST; ++i) last[i] = y[at_last[i]];
  if (k == c->n && (hs_lost(sum, HS_SUM) || hs_lost(last, HS_LAST))) --k;
  b->lost[run] = k < c->n ? (int)k + 1 : 0;
  b->unsolved[run] = (int)t.unsolved;
  if (k == c->n) return;
  for (int i = 0; i < HS_FOUND; ++i) sum[i] = NAN;
  for (long i = 0; i < c->n * HS_KEPT; ++i) kept[i] = NAN;
}

#endif

static void *work(void *given) {
  batch *b = (batch *)given;
  for (long run; (run = __atomic_fetch_add(&b->next, HS_LANES, __ATOMIC_RELAXED)) < b->runs;) march_some(b, run);
  return NULL;
}

#define HS_THREADS 1024

/* Run a batch on some threads, of which the caller's is one. */
HS_EXPORT void hs_batch(batch *b, int threads) {
  pthread_t others[HS_THREADS];
  int n = 0;
  while (n < threads - 1 && n < HS_THREADS && !pthread_create(others + n, NULL, work, b)) ++n;
  work(b);
  while (n) pthread_join(others[--n], NULL);
}
