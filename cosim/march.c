/* Marches the step over a cycle.  Included after the step's code; HS_X_*, HS_Y_* and HS_P_* are positions in state, outputs and parameters,
   hs_decisions those of the states that hold decisions of the controls, ended by -1. */

#if defined(_WIN32)
#define HS_EXPORT __declspec(dllexport)
#else
#define HS_EXPORT __attribute__((visibility("default")))
#endif

enum { HYBRID, REFINED, ITERATION };

/* A request counts as reached when it is missed by no more than this [m/s]. */
#define HS_REACHED 1e-9
/* The refined end speed lies this close to the best one [m/s]; in short steps closer, this acceleration times dt. */
#define HS_CLOSE 1e-5
#define HS_CLOSE_RATE 1e-4
/* The search follows the slope of the shortfall for this many trials, then it bisects. */
#define HS_SLOPES 12
/* By then bisection has ended, from whatever speed. */
#define HS_TRIALS 100
/* No vehicle gains speed faster than this against its brakes [m/s^2]. */
#define HS_FALL 100

/* A search for the largest end speed that is reached when it is asked for: up to it the shortfall is not positive, above it is, and
   mostly straight.  `search_next` says which request is tried next, `search_tell` is told its shortfall.  All speeds are taken times
   `sign`, so that it always looks for the largest one. */
typedef struct {
  int mode, stage, trials;
  int sign; /* 1 after a request that the vehicle is too slow for, -1 after one that it is too fast for */
  double v_start, lowest, close;
  double low, high, s_high, s_next, climb, width, next;
  /* What the last search taught: gain of speed, and slope of the shortfall. */
  double gain, slope;
} search;

enum { FIRST, WIDEN, HALVE, LAST };

/* Begin after the request `v` fell short by `s`, from the state `x`, in a step of length `dt`. */
static void search_begin(search *t, int mode, double v, double s, double v_start, double dt) {
  const int sign = s > 0 ? 1 : -1;
  if (sign != t->sign) t->gain = 0, t->slope = 1;
  t->mode = mode;
  t->sign = sign;
  t->stage = FIRST;
  t->trials = 0;
  t->v_start = sign * v_start;
  /* A speed that falls short of none: standstill, or what no brake is needed for. */
  t->lowest = sign > 0 ? 0 : -(v_start + HS_FALL * dt);
  t->close = fmin(HS_CLOSE, HS_CLOSE_RATE * dt);
  t->high = sign * v;
  t->s_high = t->s_next = fabs(s);
  t->low = mode == REFINED ? t->lowest : t->high;
  t->climb = 0.02;
  t->width = fabs(s) > 0.5 ? fabs(s) : 0.5;
  t->next = t->gain != 0 && t->v_start + t->gain < t->high ? t->v_start + t->gain : t->high - t->s_high;
}

/* The paper's benchmark: bisection to the last digits. */
static int iterate_next(search *t, int failed) {
  const double middle = 0.5 * (t->low + t->high);
  if (t->stage == LAST) return 0;
  if (t->stage == FIRST || (t->stage == WIDEN && t->s_next > HS_REACHED && t->low > t->lowest && !failed)) {
    t->stage = WIDEN;
    t->high = t->low;
    t->next = t->low = t->low - t->width > t->lowest ? t->low - t->width : t->lowest;
    t->width *= 2;
    return 1;
  }
  t->stage = t->high - t->low > 1e-12 * (1 + fabs(t->high)) && middle > t->low && middle < t->high ? HALVE : LAST;
  t->next = t->stage == HALVE ? middle : t->low;
  return 1;
}

/* Return whether there is another request to try: `next`. */
static int search_next(search *t, int failed) {
  if (t->mode == ITERATION) return iterate_next(t, failed);
  if (t->stage == LAST) return 0;
  if (t->trials < HS_TRIALS && t->s_high >= t->close && t->high - t->low >= t->close && !failed) {
    if (t->trials >= HS_SLOPES || !(t->next > t->low && t->next < t->high)) t->next = 0.5 * (t->low + t->high);
    return 1;
  }
  t->stage = LAST;
  t->next = t->low;
  return t->s_high >= t->close && t->s_next > HS_REACHED;
}

/* Take the shortfall of the request that was tried. */
static void search_tell(search *t, double s) {
  int near = t->high - t->next < 1;
  t->s_next = s;
  if (t->stage == LAST || t->stage == WIDEN) return;
  if (t->stage == HALVE) {
    if (s <= HS_REACHED) t->low = t->next; else t->high = t->next;
    return;
  }
  ++t->trials;
  if (s > HS_REACHED) {
    if (near && t->s_high > s) t->slope = (t->s_high - s) / (t->high - t->next);
    t->high = t->next;
    t->s_high = s;
    near = 1;
  } else {
    t->low = t->next;
  }
  t->next = near ? t->high - t->s_high / (t->slope > 0.1 ? t->slope : 1) + 0.3 * t->close : t->low + t->climb;
  if (!near) t->climb *= 4;
}

/* Return whether the speed that the search left the step at, or a hair above it, is reached. */
static int search_end(search *t, double v) {
  t->gain = t->sign * v - t->v_start;
  return t->mode == REFINED ? fabs(t->s_next) < t->close : fabs(t->s_next) <= HS_REACHED;
}

typedef struct {
  const double *x, *p, *q;
  double *u, *xn, *y;
  long evaluations;
  int failed;
  search search;
  /* Searches without success. */
  long unsolved;
  /* The state from which was searched: with what the controls had decided. */
  double decided[HS_NX];
} trial;

/* Return a trial at the start of a march. */
static trial first_trial(const double *p, const double *q, double *u) {
  trial t = {0, p, q, u, 0, 0, 0, 0, {.sign = 1, .slope = 1}, 0, {0}};
  return t;
}

/* Shortfall of the end speed when `v` is asked for. */
static double shortfall(trial *t, int sign, double v) {
  t->u[0] = sign * v;
  hs_step_prepared(t->x, t->u, t->p, t->q, t->xn, t->y);
  ++t->evaluations;
  return v - sign * t->xn[HS_X_V];
}

/* The interval of rising numbers in which `s` lies. */
static long interval_of(double s, long n, const double *distance) {
  long low = 0, high = n - 1;
  while (high - low > 1) {
    long middle = (low + high) / 2;
    if (distance[middle] <= s) low = middle; else high = middle;
  }
  return low;
}

static double grade_at(double s, long n, const double *distance, const double *grade) {
  if (s <= distance[0]) return grade[0];
  if (s >= distance[n - 1]) return grade[n - 1];
  const long i = interval_of(s, n, distance);
  return grade[i] + (grade[i + 1] - grade[i]) * (s - distance[i]) / (distance[i + 1] - distance[i]);
}

/* So many rows of outputs are totalled at once, while they are near. */
enum { HS_ROWS = 16 };

/* Add `n` rows of outputs to their time integrals and maxima; four at a time, so that these are fetched and stored less often. */
static void total(long n, const double *restrict rows, const double *restrict dt, double *restrict sums, double *restrict highest) {
  long k = 0;
  for (; k + 4 <= n; k += 4) {
    const double *a = rows + k * HS_NY, *b = a + HS_NY, *c = b + HS_NY, *d = c + HS_NY;
    for (int i = 0; i < HS_NY; ++i) {
      sums[i] = sums[i] + a[i] * dt[k] + b[i] * dt[k + 1] + c[i] * dt[k + 2] + d[i] * dt[k + 3];
      highest[i] = hs_max(d[i], hs_max(c[i], hs_max(b[i], hs_max(a[i], highest[i]))));
    }
  }
  for (; k < n; ++k) {
    const double *y = rows + k * HS_NY;
    for (int i = 0; i < HS_NY; ++i) { sums[i] += y[i] * dt[k]; highest[i] = hs_max(y[i], highest[i]); }
  }
}

/* Step from the state `now` to `next`, with the request in `t->u`; `y` gets the outputs. */
static void advance(trial *t, double *now, double *next, double *y, int mode) {
  const double v = t->u[0];
  t->failed |= hs_lost(t->u, HS_NU);
  /* A speed that was solved for was reached: the step after it has nothing to estimate. */
  if (mode != HYBRID) now[HS_X_MISSED] = 0;
  t->x = now; t->xn = next; t->y = y;
  const double s = shortfall(t, 1, v);
  if (mode != HYBRID && fabs(s) > HS_REACHED) {
    /* The controls have decided by what was asked for; the search keeps gear and clutch. */
    double *decided = t->decided;
    for (int i = 0; i < HS_NX; ++i) decided[i] = now[i];
    for (const int *d = hs_decisions; *d >= 0; ++d) decided[*d] = next[*d];
    t->x = decided;
    t->u[4] = 1;
    search_begin(&t->search, mode, v, s, now[HS_X_V], t->u[3]);
    while (search_next(&t->search, t->failed)) search_tell(&t->search, shortfall(t, t->search.sign, t->search.next));
    if (!search_end(&t->search, next[HS_X_V])) {
      /* No speed is reached at all: the plain step is kept. */
      shortfall(t, 1, v);
      ++t->unsolved;
    }
    for (const int *d = hs_decisions; *d >= 0; ++d) next[*d] = decided[*d];
    y[HS_Y_REQUEST] = v;
    y[HS_Y_MISS] = v - next[HS_X_V];
    y[HS_Y_OVERSPEED] = -y[HS_Y_MISS];
    next[HS_X_MISSED] = y[HS_Y_MISS] > t->p[HS_P_MISS];
  }
}

/* March `n` steps from the state `x`, or where not `started` from the start state; `x` becomes the last state.  `history`
   holds n rows of outputs; where it is null, `last` gets the last row, `sums` the time integrals and `highest` the maxima of all outputs.
   Returns the number of steps done; less than n if a number was lost, among the outputs only where they are not kept.  `counts` gets
   the number of calls of the step, and of searches without success.  `more` holds n rows of what a step requests beyond the plain ones. */
HS_EXPORT long hs_march(long n, const double *dt, const double *v, const double *grade, const double *key_on, const double *more,
                        long n_grade, const double *grade_distance, const double *grade_value, const double *p, int started, double *x,
                        double *history, double *last, double *restrict sums, double *restrict highest, int mode, long *counts) {
  double state[2][HS_NX], u[HS_NU], q[HS_NQ], rows[HS_ROWS * HS_NY];
  double *now = state[0], *next = state[1];
  trial t = first_trial(p, q, u);
  long k, totalled = 0;
  if (!started) hs_start(p, x);
  t.failed = hs_prepare(p, q) | hs_lost(x, HS_NX);
  for (int i = 0; i < HS_NX; ++i) now[i] = x[i];
  for (int i = 0; !history && i < HS_NY; ++i) { last[i] = sums[i] = 0; highest[i] = -HUGE_VAL; }
  for (k = 0; k < n; ++k) {
    double *y = history ? history + k * HS_NY : rows + (k - totalled) * HS_NY;
    u[1] = n_grade ? grade_at(now[HS_X_DISTANCE], n_grade, grade_distance, grade_value) : grade[k];
    u[2] = key_on[k];
    u[3] = dt[k];
    u[4] = 0;
    for (int i = 5; i < HS_NU; ++i) u[i] = more[k * (HS_NU - 5) + i - 5];
    u[0] = v[k];
    advance(&t, now, next, y, mode);
    /* What is lost stays lost in a state: now and then is often enough to look. */
    const int filled = k + 1 == totalled + HS_ROWS || k + 1 == n;
    if (filled) t.failed |= hs_lost(next, HS_NX);
    if (t.failed) break;
    if (filled && !history) {
      const long count = k + 1 - totalled;
      total(count, y - (count - 1) * HS_NY, dt + totalled, sums, highest);
      if (hs_lost(sums, HS_NY)) break;
      if (k + 1 == n) for (int i = 0; i < HS_NY; ++i) last[i] = y[i];
    }
    if (filled) totalled = k + 1;
    double *swap = now; now = next; next = swap;
  }
  for (int i = 0; i < HS_NX; ++i) x[i] = now[i];
  counts[0] = t.evaluations;
  counts[1] = t.unsolved;
  return k;
}

/* Total a history: `sums` and `highest` get the time integrals and the maxima of all outputs. */
HS_EXPORT void hs_total(long n, const double *dt, const double *history, double *sums, double *highest) {
  for (int i = 0; i < HS_NY; ++i) { sums[i] = 0; highest[i] = -HUGE_VAL; }
  total(n, history, dt, sums, highest);
}

HS_EXPORT int hs_one(const double *x, const double *u, const double *p, double *xn, double *y) { return hs_step(x, u, p, xn, y); }

HS_EXPORT void hs_first(const double *p, double *x) { hs_start(p, x); }
