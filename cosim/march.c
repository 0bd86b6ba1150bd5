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
/* The refined end speed lies this close to the largest one that can be reached [m/s]. */
#define HS_CLOSE 1e-5
/* The search may take this many steps before the plain step is kept. */
#define HS_TRIALS 24

typedef struct {
  const double *x, *p, *q;
  double *u, *xn, *y;
  long evaluations;
  int failed;
  /* What the last refined step taught: gain of speed, slope of the shortfall. */
  double gain, slope;
} trial;

/* Shortfall of the end speed when `v` is asked for. */
static double shortfall(trial *t, double v) {
  t->u[0] = v;
  hs_step_prepared(t->x, t->u, t->p, t->q, t->xn, t->y);
  ++t->evaluations;
  return v - t->xn[HS_X_V];
}

/* Find the largest end speed that is reached when it is asked for.  The shortfall is zero up to it and positive,
   nearly straight, above.  Leaves the step a hair above that kink, or leaves the plain step if none is found.  `s` is
   the shortfall at the request `v`. */
static void refine(trial *t, double v, double s) {
  const double request = v, v_start = t->x[HS_X_V];
  double high = v, s_high = s, low = 0, climb = 0.02;
  double next = t->gain > 0 && v_start + t->gain < v ? v_start + t->gain : v - s;
  for (int i = 0; i < HS_TRIALS && !t->failed; ++i) {
    double s_next = shortfall(t, next);
    int near = high - next < 1;
    if (s_next > HS_REACHED) {
      if (near && s_high > s_next) t->slope = (s_high - s_next) / (high - next);
      high = next;
      s_high = s_next;
      if (s_high < HS_CLOSE) { t->gain = high - v_start; return; }
      next = high - s_high / (t->slope > 0.1 ? t->slope : 1) + 0.3 * HS_CLOSE;
    } else {
      low = next;
      if (high - low < HS_CLOSE) { t->gain = low - v_start; return; }
      next = near ? high - s_high / (t->slope > 0.1 ? t->slope : 1) + 0.3 * HS_CLOSE : low + climb;
      climb *= 4;
    }
    if (next <= low || next >= high) next = 0.5 * (low + high);
  }
  shortfall(t, request);
}

/* The same speed by bisection: the paper's benchmark. */
static double iterate(trial *t, double v, double s) {
  double high = v, low = v, width = s > 0.5 ? s : 0.5;
  do {
    high = low;
    low = low > width ? low - width : 0;
    width *= 2;
  } while (shortfall(t, low) > HS_REACHED && low > 0 && !t->failed);
  if (t->xn[HS_X_V] < low - HS_REACHED) {
    shortfall(t, v);
    return v;
  }
  while (high - low > 1e-12 * (1 + high)) {
    double middle = 0.5 * (low + high);
    if (middle <= low || middle >= high) break;
    if (shortfall(t, middle) <= HS_REACHED) low = middle; else high = middle;
  }
  shortfall(t, low);
  return low;
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

/* March `n` steps from the state `x`, or where not `started` from the start state; `x` becomes the last state.  `history`
   holds n rows of outputs; where it is null, `sums` gets the time integrals and `highest` the maxima of all outputs.
   Returns the number of steps done; less than n if a number was lost.  `evaluations` gets the number of calls of the
   step. */
HS_EXPORT long hs_march(long n, const double *dt, const double *v, const double *grade, const double *key_on, long n_grade,
                        const double *grade_distance, const double *grade_value, const double *p, int started, double *x,
                        double *history, double *restrict sums, double *restrict highest, int mode, long *evaluations) {
  double state[2][HS_NX], decided[HS_NX], row[HS_NY], u[HS_NU], q[HS_NQ];
  double *now = state[0], *next = state[1];
  trial t = {0, p, q, u, 0, 0, 0, 0, 0, 1};
  long k;
  if (!started) hs_start(p, x);
  t.failed = hs_prepare(p, q) | hs_lost(x, HS_NX);
  for (int i = 0; i < HS_NX; ++i) now[i] = x[i];
  for (int i = 0; !history && i < HS_NY; ++i) { sums[i] = 0; highest[i] = -HUGE_VAL; }
  for (k = 0; k < n; ++k) {
    double *y = history ? history + k * HS_NY : row;
    u[1] = n_grade ? grade_at(now[HS_X_DISTANCE], n_grade, grade_distance, grade_value) : grade[k];
    u[2] = key_on[k];
    u[3] = dt[k];
    u[4] = 0;
    u[0] = v[k];
    t.failed |= hs_lost(u, HS_NU);
    /* A speed that was solved for was reached: the step after it has nothing to estimate. */
    if (mode != HYBRID) now[HS_X_MISSED] = 0;
    t.x = now; t.xn = next; t.y = y;
    double s = shortfall(&t, v[k]);
    if (mode != HYBRID && s > HS_REACHED) {
      /* The controls have decided by what was asked for; the search keeps gear and clutch. */
      for (int i = 0; i < HS_NX; ++i) decided[i] = now[i];
      for (const int *d = hs_decisions; *d >= 0; ++d) decided[*d] = next[*d];
      decided[HS_X_MISSED] = 0;
      t.x = decided;
      u[4] = 1;
      if (mode == REFINED) refine(&t, v[k], s); else iterate(&t, v[k], s);
      for (const int *d = hs_decisions; *d >= 0; ++d) next[*d] = decided[*d];
      y[HS_Y_REQUEST] = v[k];
      y[HS_Y_MISS] = v[k] - next[HS_X_V];
      next[HS_X_MISSED] = y[HS_Y_MISS] > p[HS_P_MISS];
    }
    /* What is lost stays lost in a state: now and then is often enough to look. */
    if (k % 16 == 15 || k == n - 1) t.failed |= hs_lost(next, HS_NX);
    if (t.failed) break;
    if (!history)
      for (int i = 0; i < HS_NY; ++i) {
        sums[i] += y[i] * dt[k];
        highest[i] = y[i] > highest[i] ? y[i] : highest[i];
      }
    double *swap = now; now = next; next = swap;
  }
  for (int i = 0; i < HS_NX; ++i) x[i] = now[i];
  *evaluations = t.evaluations;
  return k;
}

HS_EXPORT int hs_one(const double *x, const double *u, const double *p, double *xn, double *y) { return hs_step(x, u, p, xn, y); }

HS_EXPORT void hs_first(const double *p, double *x) { hs_start(p, x); }
