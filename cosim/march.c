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

typedef struct {
  const double *x, *p, *q;
  double *u, *xn, *y;
  long evaluations;
  int failed;
  /* 1 after a request that the vehicle is too slow for, -1 after one that it is too fast for.  A search takes all speeds times this,
     so that it always looks for the largest one. */
  int sign;
  /* What the last refined step taught: gain of speed, slope of the shortfall, and the sign of its search. */
  double gain, slope;
  int searched;
  /* Searches without success. */
  long unsolved;
} trial;

/* Return a trial at the start of a march. */
static trial first_trial(const double *p, const double *q, double *u) {
  trial t = {0, p, q, u, 0, 0, 0, 0, 1, 0, 1, 1, 0};
  return t;
}

/* Shortfall of the end speed when `v` is asked for. */
static double shortfall(trial *t, double v) {
  t->u[0] = t->sign * v;
  hs_step_prepared(t->x, t->u, t->p, t->q, t->xn, t->y);
  ++t->evaluations;
  return v - t->sign * t->xn[HS_X_V];
}

/* Return a speed that falls short of none: standstill, or what no brake is needed for. */
static double bottom(const trial *t) { return t->sign > 0 ? 0 : -(t->x[HS_X_V] + HS_FALL * t->u[3]); }

/* Find the largest end speed that is reached when it is asked for.  Up to it the shortfall is not positive, above it is, and
   mostly straight.  Leaves the step there or a hair above; returns whether there is such a speed.  `s` is the shortfall at
   the request `v`. */
static int refine(trial *t, double v, double s) {
  const double v_start = t->sign * t->x[HS_X_V], close = fmin(HS_CLOSE, HS_CLOSE_RATE * t->u[3]);
  double low = bottom(t), high = v, s_high = s, climb = 0.02, s_next = s;
  double next = t->gain != 0 && v_start + t->gain < v ? v_start + t->gain : v - s;
  for (int i = 0; i < HS_TRIALS && s_high >= close && high - low >= close && !t->failed; ++i) {
    if (i >= HS_SLOPES || !(next > low && next < high)) next = 0.5 * (low + high);
    s_next = shortfall(t, next);
    int near = high - next < 1;
    if (s_next > HS_REACHED) {
      if (near && s_high > s_next) t->slope = (s_high - s_next) / (high - next);
      high = next;
      s_high = s_next;
      near = 1;
    } else {
      low = next;
    }
    next = near ? high - s_high / (t->slope > 0.1 ? t->slope : 1) + 0.3 * close : low + climb;
    if (!near) climb *= 4;
  }
  if (s_high >= close && s_next > HS_REACHED) s_next = shortfall(t, low);
  t->gain = t->sign * t->xn[HS_X_V] - v_start;
  return fabs(s_next) < close;
}

/* The same speed by bisection: the paper's benchmark. */
static int iterate(trial *t, double v, double s) {
  const double lowest = bottom(t);
  double high = v, low = v, width = s > 0.5 ? s : 0.5;
  do {
    high = low;
    low = low - width > lowest ? low - width : lowest;
    width *= 2;
  } while (shortfall(t, low) > HS_REACHED && low > lowest && !t->failed);
  while (high - low > 1e-12 * (1 + fabs(high))) {
    double middle = 0.5 * (low + high);
    if (middle <= low || middle >= high) break;
    if (shortfall(t, middle) <= HS_REACHED) low = middle; else high = middle;
  }
  return fabs(shortfall(t, low)) <= HS_REACHED;
}

static double grade_at(double s, long n, const double *distance, const double *grade) {
  long low = 0, high = n - 1;
  if (s <= distance[0]) return grade[0];
  if (s >= distance[high]) return grade[high];
  while (high - low > 1) {
    long middle = (low + high) / 2;
    if (distance[middle] <= s) low = middle; else high = middle;
  }
  return grade[low] + (grade[high] - grade[low]) * (s - distance[low]) / (distance[high] - distance[low]);
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
  double decided[HS_NX];
  t->failed |= hs_lost(t->u, HS_NU);
  /* A speed that was solved for was reached: the step after it has nothing to estimate. */
  if (mode != HYBRID) now[HS_X_MISSED] = 0;
  t->x = now; t->xn = next; t->y = y;
  t->sign = 1;
  double s = shortfall(t, v);
  if (mode != HYBRID && fabs(s) > HS_REACHED) {
    /* The controls have decided by what was asked for; the search keeps gear and clutch. */
    for (int i = 0; i < HS_NX; ++i) decided[i] = now[i];
    for (const int *d = hs_decisions; *d >= 0; ++d) decided[*d] = next[*d];
    t->x = decided;
    t->u[4] = 1;
    t->sign = s > 0 ? 1 : -1;
    if (t->sign != t->searched) t->gain = 0, t->slope = 1;
    t->searched = t->sign;
    if (!(mode == REFINED ? refine : iterate)(t, t->sign * v, fabs(s))) {
      /* No speed is reached at all: the plain step is kept. */
      shortfall(t, t->sign * v);
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
   holds n rows of outputs, or is null; `last` gets the last row, `sums` the time integrals and `highest` the maxima of all outputs.
   Returns the number of steps done; less than n if a number was lost, among the outputs only where they are not kept.  `counts` gets
   the number of calls of the step, and of searches without success. */
HS_EXPORT long hs_march(long n, const double *dt, const double *v, const double *grade, const double *key_on, long n_grade,
                        const double *grade_distance, const double *grade_value, const double *p, int started, double *x,
                        double *history, double *last, double *restrict sums, double *restrict highest, int mode, long *counts) {
  double state[2][HS_NX], u[HS_NU], q[HS_NQ], rows[HS_ROWS * HS_NY];
  double *now = state[0], *next = state[1];
  trial t = first_trial(p, q, u);
  long k, totalled = 0;
  if (!started) hs_start(p, x);
  t.failed = hs_prepare(p, q) | hs_lost(x, HS_NX);
  for (int i = 0; i < HS_NX; ++i) now[i] = x[i];
  for (int i = 0; i < HS_NY; ++i) { last[i] = sums[i] = 0; highest[i] = -HUGE_VAL; }
  for (k = 0; k < n; ++k) {
    double *y = history ? history + k * HS_NY : rows + (k - totalled) * HS_NY;
    u[1] = n_grade ? grade_at(now[HS_X_DISTANCE], n_grade, grade_distance, grade_value) : grade[k];
    u[2] = key_on[k];
    u[3] = dt[k];
    u[4] = 0;
    u[0] = v[k];
    advance(&t, now, next, y, mode);
    /* What is lost stays lost in a state: now and then is often enough to look. */
    const int filled = k + 1 == totalled + HS_ROWS || k + 1 == n;
    if (filled) t.failed |= hs_lost(next, HS_NX);
    if (t.failed) break;
    if (filled) {
      const long count = k + 1 - totalled;
      total(count, y - (count - 1) * HS_NY, dt + totalled, sums, highest);
      if (!history && hs_lost(sums, HS_NY)) break;
      totalled = k + 1;
      if (totalled == n) for (int i = 0; i < HS_NY; ++i) last[i] = y[i];
    }
    double *swap = now; now = next; next = swap;
  }
  for (int i = 0; i < HS_NX; ++i) x[i] = now[i];
  counts[0] = t.evaluations;
  counts[1] = t.unsolved;
  return k;
}

HS_EXPORT int hs_one(const double *x, const double *u, const double *p, double *xn, double *y) { return hs_step(x, u, p, xn, y); }

HS_EXPORT void hs_first(const double *p, double *x) { hs_start(p, x); }
