/* Marches the step over a cycle with tangents: derivatives by HS_TANGENTS numbers.  Included after march.c and the step with tangents.

   Where an end speed v is solved for, f(r) is the end speed that follows from the request r.  Up to the best one it is r itself, above
   it falls short; from r - f(r, p) = 0, seen from above, follows dv = f_p / (1 - f_r). */

/* Below this the end speed does not tell what it depends on. */
#define HS_FLAT 1e-6

typedef struct {
  const vt *p, *q;
  vt x[HS_NX], u[HS_NU], next[HS_NX], y[HS_NY];
} tangents;

static const vt no_tangents[HS_NX > HS_NP ? (HS_NX > HS_NQ ? HS_NX : HS_NQ) : (HS_NP > HS_NQ ? HS_NP : HS_NQ)];

/* How the grade changes with the way. */
static double slope_at(double s, long n, const double *distance, const double *grade) {
  if (s <= distance[0] || s >= distance[n - 1]) return 0;
  const long i = interval_of(s, n, distance);
  return (grade[i + 1] - grade[i]) / (distance[i + 1] - distance[i]);
}

/* Derivative of the best end speed, from the request of a search that last fell short. */
static vt of_best(const trial *t, const tangents *d, const vt *dx) {
  double u[HS_NU], next[HS_NX], y[HS_NY];
  vt du[HS_NU] = {{0}}, dnext[HS_NX], dy[HS_NY];
  for (int i = 0; i < HS_NU; ++i) u[i] = t->u[i];
  u[0] = t->search.sign * t->search.high;
  for (int i = 1; i < HS_NU; ++i) du[i] = d->u[i];
  hs_step_tangents(t->x, dx, u, du, t->p, d->p, t->q, d->q, next, dnext, y, dy);
  const vt by_parameters = dnext[HS_X_V];
  for (int i = 1; i < HS_NU; ++i) du[i] = HS_NONE;
  du[0] = HS_NONE + 1.;
  hs_step_tangents(t->x, no_tangents, u, du, t->p, no_tangents, t->q, no_tangents, next, dnext, y, dy);
  const double fall = 1 - dnext[HS_X_V][0];
  return fall > HS_FLAT ? by_parameters * (1 / fall) : HS_NONE;
}

/* Step from the state `now` to `next`, as `advance`; `d` takes the tangents along. */
static void advance_tangents(trial *t, tangents *d, double *now, double *next, double *y, int mode) {
  const double v = t->u[0];
  if (mode != HYBRID) now[HS_X_MISSED] = 0;
  t->failed |= hs_lost(t->u, HS_NU);
  d->u[0] = HS_NONE;
  hs_step_tangents(now, d->x, t->u, d->u, t->p, d->p, t->q, d->q, next, d->next, y, d->y);
  ++t->evaluations;
  if (mode == HYBRID || !(fabs(v - next[HS_X_V]) > HS_REACHED)) return;
  /* The controls have decided in this step already. */
  vt decided[HS_NX], fixed[HS_NX];
  for (int i = 0; i < HS_NX; ++i) decided[i] = d->x[i], fixed[i] = HS_NONE;
  for (const int *i = hs_decisions; *i >= 0; ++i) decided[*i] = fixed[*i] = d->next[*i];
  const long unsolved = t->unsolved;
  double found[HS_NX], shown[HS_NY];
  advance(t, now, next, y, mode);
  if (t->unsolved == unsolved) d->u[0] = of_best(t, d, decided);
  hs_step_tangents(t->decided, decided, t->u, d->u, t->p, d->p, t->q, d->q, found, d->next, shown, d->y);
  for (const int *i = hs_decisions; *i >= 0; ++i) d->next[*i] = fixed[*i];
  d->next[HS_X_MISSED] = HS_NONE;
  d->y[HS_Y_REQUEST] = HS_NONE;
  d->y[HS_Y_MISS] = -d->next[HS_X_V];
  d->y[HS_Y_OVERSPEED] = d->next[HS_X_V];
}

/* March `n` steps as `hs_march`, from the start state of the parameters.  `x` are start values of the states `x_of`,
   `first` gets all of them.  Of all outputs
   `totals` gets last values, time integrals, maxima and minima, `dtotals` their tangents; `history` and `dhistory`, where they are not
   null, get all.  Returns the number of steps done, less than n if a number was lost; `unsolved` the number of searches without success. */
HS_EXPORT long hs_march_tangents(long n, const double *dt, const double *v, const double *grade, const double *key_on,
                                 const double *more, long n_grade, const double *grade_distance, const double *grade_value, const double *p, const vt *dp, long n_x,
                                 const double *x, const int *x_of, double *first, vt *dfirst, double *history,
                                 vt *dhistory, double *totals, vt *dtotals, int mode, long *unsolved) {
  double state[2][HS_NX], u[HS_NU], q[HS_NQ], y[HS_NY];
  double *now = state[0], *next = state[1], *last = totals, *sum = last + HS_NY, *max = sum + HS_NY, *min = max + HS_NY;
  vt dq[HS_NQ], *dlast = dtotals, *dsum = dlast + HS_NY, *dmax = dsum + HS_NY, *dmin = dmax + HS_NY;
  trial t = first_trial(p, q, u);
  tangents d = {dp, dq, {{0}}, {{0}}, {{0}}, {{0}}};
  long k;
  hs_start_tangents(p, dp, now, d.x);
  for (long i = 0; i < n_x; ++i) now[x_of[i]] = x[i], d.x[x_of[i]] = HS_NONE;
  for (int i = 0; i < HS_NX; ++i) first[i] = now[i], dfirst[i] = d.x[i];
  t.failed = hs_prepare(p, q) | hs_lost(now, HS_NX);
  hs_prepare_tangents(p, dp, dq);
  for (int i = 0; i < HS_NY; ++i) {
    last[i] = sum[i] = 0, max[i] = -HUGE_VAL, min[i] = HUGE_VAL;
    dlast[i] = dsum[i] = dmax[i] = dmin[i] = HS_NONE;
  }
  for (k = 0; k < n; ++k) {
    u[0] = v[k];
    u[1] = n_grade ? grade_at(now[HS_X_DISTANCE], n_grade, grade_distance, grade_value) : grade[k];
    u[2] = key_on[k];
    u[3] = dt[k];
    u[4] = 0;
    for (int i = 5; i < HS_NU; ++i) u[i] = more[k * (HS_NU - 5) + i - 5];
    d.u[1] = n_grade ? d.x[HS_X_DISTANCE] * slope_at(now[HS_X_DISTANCE], n_grade, grade_distance, grade_value) : HS_NONE;
    advance_tangents(&t, &d, now, next, y, mode);
    t.failed |= hs_lost(next, HS_NX) | hs_lost(y, HS_NY);
    if (t.failed) break;
    for (int i = 0; i < HS_NY; ++i) {
      sum[i] += y[i] * dt[k], dsum[i] += d.y[i] * dt[k];
      if (y[i] > max[i]) max[i] = y[i], dmax[i] = d.y[i];
      if (y[i] < min[i]) min[i] = y[i], dmin[i] = d.y[i];
      if (history) history[k * HS_NY + i] = y[i], dhistory[k * HS_NY + i] = d.y[i];
    }
    for (int i = 0; i < HS_NX; ++i) d.x[i] = d.next[i];
    double *swap = now; now = next; next = swap;
  }
  for (int i = 0; k && i < HS_NY; ++i) last[i] = y[i], dlast[i] = d.y[i];
  *unsolved = t.unsolved;
  return k;
}
