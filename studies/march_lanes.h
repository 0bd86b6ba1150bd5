/* Marches vehicles in lockstep, a lane each: `march_some` of batch.c for HS_LANES runs.  A lane whose cycle has ended, or whose numbers are
   lost, goes on, but nothing is taken from it any more. */

#include <string.h>

#define LINED __attribute__((aligned(64)))
/* Value `i` of lane `l`. */
#define AT(a, i, l) ((a)[(i) * HS_LANES + (l)])
/* Whether lane `l` belongs to a set, which has the bits of each block. */
#define IN(set, l) ((set)[(l) / W] >> (l) % W & 1)

typedef struct {
  double state[2][HS_NX * HS_LANES], u[HS_NU * HS_LANES], w[HS_NW * HS_LANES], y[HS_NY * HS_LANES], q[HS_NL * HS_LANES];
  double *now, *next;
  search search[HS_LANES];
  double miss[HS_LANES]; /* the threshold of a miss */
  int unsolved[HS_LANES];
} group;

/* Ask of lane `l`, or of all. */
static void ask(group *g, const double *u, int l, int all) {
  double w[HS_NW];
  hs_prepare_cycle(u, w);
  for (int i = 0; i < HS_NU + HS_NW; ++i) {
    double *to = i < HS_NU ? &AT(g->u, i, 0) : &AT(g->w, i - HS_NU, 0);
    const double value = i < HS_NU ? u[i] : w[i - HS_NU];
    if (!all) to[l] = value;
    /* Read as vectors, they come sooner if they were written so. */
    for (int b = 0; all && b < HS_BLOCKS; ++b) v_store(to + b * W, v_set(value));
  }
}

/* Ask lane `l` for another speed; the controls keep what they decided. */
static void ask_again(group *g, double v, int l) {
  const double u[HS_NU] = {v, AT(g->u, 1, l), AT(g->u, 2, l), AT(g->u, 3, l), 1};
  ask(g, u, l, 0);
}

/* Take the lanes of a set from one array of `n` values to another. */
static void take(const int *of, int n, const double *from, double *to) {
  for (int b = 0; b < HS_BLOCKS; ++b) {
    const vm lanes = v_of_bits(of[b]);
    for (int i = 0; i < n; ++i) {
      const int j = (i * HS_BLOCKS + b) * W;
      v_store(to + j, v_choose(lanes, v_load(from + j), v_load(to + j)));
    }
  }
}

/* Step with what the lanes of `tried` ask for, and keep the step of those. */
static void try_step(group *g, const double *x, const int *tried) {
  double next[HS_NX * HS_LANES] LINED, y[HS_NY * HS_LANES] LINED;
  hs_step_lanes(x, g->u, g->w, g->q, next, y);
  take(tried, HS_NX, next, g->next);
  take(tried, HS_NY, y, g->y);
}

/* Solve for the end speeds of all lanes of `live` that missed their requests: `advance` of march.c, lane by lane. */
static void solve(group *g, const int *live, int mode) {
  double decided[HS_NX * HS_LANES] LINED, v[HS_LANES];
  int sought[HS_BLOCKS] = {0}, failed[HS_BLOCKS] = {0}, any = 0;
  for (int l = 0; l < HS_LANES; ++l) {
    const double s = AT(g->u, 0, l) - AT(g->next, HS_X_V, l);
    v[l] = AT(g->u, 0, l);
    if (!IN(live, l) || !(fabs(s) > HS_REACHED)) continue;
    search_begin(g->search + l, mode, v[l], s, AT(g->now, HS_X_V, l), AT(g->u, 3, l));
    sought[l / W] |= 1 << l % W;
    any = 1;
  }
  if (!any) return;
  memcpy(decided, g->now, sizeof decided);
  for (const int *d = hs_decisions; *d >= 0; ++d) memcpy(&AT(decided, *d, 0), &AT(g->next, *d, 0), HS_LANES * sizeof(double));
  for (;;) {
    int tried[HS_BLOCKS] = {0};
    any = 0;
    for (int l = 0; l < HS_LANES; ++l) {
      search *t = g->search + l;
      if (!IN(sought, l) || !search_next(t, 0)) continue;
      ask_again(g, t->sign * t->next, l);
      tried[l / W] |= 1 << l % W;
      any = 1;
    }
    if (!any) break;
    try_step(g, decided, tried);
    for (int l = 0; l < HS_LANES; ++l) {
      search *t = g->search + l;
      if (IN(tried, l)) search_tell(t, t->next - t->sign * AT(g->next, HS_X_V, l));
    }
  }
  any = 0;
  for (int l = 0; l < HS_LANES; ++l) {
    if (!IN(sought, l) || search_end(g->search + l, AT(g->next, HS_X_V, l))) continue;
    /* No speed is reached at all: the plain step is kept. */
    ask_again(g, v[l], l);
    failed[l / W] |= 1 << l % W;
    ++g->unsolved[l];
    any = 1;
  }
  if (any) try_step(g, decided, failed);
  for (int l = 0; l < HS_LANES; ++l) {
    if (!IN(sought, l)) continue;
    const double miss = v[l] - AT(g->next, HS_X_V, l);
    for (const int *d = hs_decisions; *d >= 0; ++d) AT(g->next, *d, l) = AT(decided, *d, l);
    AT(g->y, HS_Y_REQUEST, l) = v[l];
    AT(g->y, HS_Y_MISS, l) = miss;
    AT(g->y, HS_Y_OVERSPEED, l) = -miss;
    AT(g->next, HS_X_MISSED, l) = miss > g->miss[l];
  }
}

/* Note which lanes of a set have lost a number by step `k`. */
static void note_lost(const group *g, const int *set, long k, long *lost) {
  for (int b = 0; b < HS_BLOCKS; ++b) {
    vd total = v_set(0);
    for (int i = 0; i < HS_NX; ++i) total = total + v_load(g->next + (i * HS_BLOCKS + b) * W);
    const int bad = v_bits(v_ne(total * v_set(0), v_set(0)));
    for (int l = b * W; bad && l < (b + 1) * W; ++l) {
      if (IN(set, l) && bad >> l % W & 1 && !lost[l]) lost[l] = k + 1;
    }
  }
}

/* Add a step of the lanes of `live` to sums, and to maxima and minima. */
static void add_up(const group *g, const int *live, double *sum, double *max, double *min) {
  for (int b = 0; b < HS_BLOCKS; ++b) {
    const vm on = v_of_bits(live[b]);
    const vd dt = v_load(g->u + (3 * HS_BLOCKS + b) * W);
#define Y(i) v_load(g->y + ((i) * HS_BLOCKS + b) * W)
    for (int i = 0; i < HS_SUM; ++i) {
      double *s = sum + (i * HS_BLOCKS + b) * W;
      v_store(s, v_choose(on, v_load(s) + Y(at_sum[i]) * dt, v_load(s)));
    }
    for (int i = 0; i < HS_MAX; ++i) {
      double *s = max + (i * HS_BLOCKS + b) * W;
      v_store(s, v_choose(on, v_max(Y(at_max[i]), v_load(s)), v_load(s)));
    }
    for (int i = 0; i < HS_MIN; ++i) {
      double *s = min + (i * HS_BLOCKS + b) * W;
      v_store(s, v_choose(on, v_min(Y(at_min[i]), v_load(s)), v_load(s)));
    }
#undef Y
  }
}

static void march_some(const batch *b, long at) {
  group g LINED;
  double sum[(HS_SUM + 1) * HS_LANES] LINED, max[(HS_MAX + 1) * HS_LANES] LINED, min[(HS_MIN + 1) * HS_LANES] LINED;
  const trace *c[HS_LANES];
  long run[HS_LANES], lost[HS_LANES], seen[HS_LANES] = {0}, longest = 0;
  int live[HS_BLOCKS] = {0}, shared = 1;
  g.now = g.state[0];
  g.next = g.state[1];
  for (int l = 0; l < HS_LANES; ++l) {
    /* The last group is filled up with its last run. */
    run[l] = b->order[at + l < b->runs ? at + l : b->runs - 1];
    c[l] = b->traces + b->trace_of[run[l]];
    const double *p = b->p + run[l] * HS_NP;
    double x[HS_NX], *begin = b->found + run[l] * HS_FOUND + HS_SUM + HS_MAX + HS_MIN + HS_LAST;
    hs_start(p, x);
    for (long i = 0; i < b->n_x; ++i) x[b->x_of[i]] = b->x[run[l] * b->n_x + i];
    lost[l] = hs_prepare_lane(p, g.q + l) | hs_lost(x, HS_NX);
    for (int i = 0; i < HS_NX; ++i) AT(g.now, i, l) = x[i];
    for (int i = 0; i < HS_BEGIN; ++i) begin[i] = x[at_begin[i]];
    for (int i = 0; i < HS_SEEN; ++i) begin[HS_BEGIN + i] = NAN;
    g.search[l] = (search){.sign = 1, .slope = 1};
    g.miss[l] = p[HS_P_MISS];
    g.unsolved[l] = 0;
    shared &= c[l] == c[0] && !c[l]->n_grade;
    longest = c[l]->n > longest ? c[l]->n : longest;
    live[l / W] |= 1 << l % W;
  }
  for (int i = 0; i < HS_SUM * HS_LANES; ++i) sum[i] = 0;
  for (int i = 0; i < HS_MAX * HS_LANES; ++i) max[i] = -HUGE_VAL;
  for (int i = 0; i < HS_MIN * HS_LANES; ++i) min[i] = HUGE_VAL;
  for (long k = 0; k < longest; ++k) {
    int ends[HS_BLOCKS] = {0}, any = 0;
    for (int l = 0; l < (shared ? 1 : HS_LANES); ++l) {
      const trace *t = c[l];
      const long j = k < t->n ? k : t->n - 1;
      const double distance = AT(g.now, HS_X_DISTANCE, l);
      const double grade = t->n_grade ? grade_at(distance, t->n_grade, t->grade_distance, t->grade_value) : t->grade[j];
      const double u[HS_NU] = {t->v[j], grade, t->key_on[j], t->dt[j], 0};
      ask(&g, u, l, shared);
      if (k == t->n - 1) ends[l / W] |= 1 << l % W, any = 1;
      if (k >= t->n) live[l / W] &= ~(1 << l % W);
    }
    for (int n = 0; shared && any && n < HS_BLOCKS; ++n) ends[n] = live[n];
    /* A speed that was solved for was reached: the step after it has nothing to estimate. */
    for (int l = 0; b->mode != HYBRID && l < HS_LANES; ++l) AT(g.now, HS_X_MISSED, l) = 0;
    hs_step_lanes(g.now, g.u, g.w, g.q, g.next, g.y);
    if (b->mode != HYBRID) solve(&g, live, b->mode);
    if (k % 16 == 15) note_lost(&g, live, k, lost);
    else if (any) note_lost(&g, ends, k, lost);
    add_up(&g, live, sum, max, min);
    for (int l = 0; (HS_SEEN || HS_KEPT || any) && l < HS_LANES; ++l) {
      double *last = b->found + run[l] * HS_FOUND + HS_SUM + HS_MAX + HS_MIN, *s = last + HS_LAST + HS_BEGIN;
      double *kept = b->history + (run[l] * b->rows + k) * HS_KEPT;
      if (!IN(live, l)) continue;
      for (; seen[l] < HS_SEEN && c[l]->at[seen[l]] <= k; ++seen[l]) {
        if (c[l]->at[seen[l]] == k) s[seen[l]] = AT(g.y, at_seen[seen[l]], l);
      }
      for (int i = 0; i < HS_KEPT; ++i) kept[i] = AT(g.y, at_kept[i], l);
      for (int i = 0; IN(ends, l) && i < HS_LAST; ++i) last[i] = AT(g.y, at_last[i], l);
    }
    double *swap = g.now; g.now = g.next; g.next = swap;
  }
  for (int l = 0; l < HS_LANES; ++l) {
    double *found = b->found + run[l] * HS_FOUND, *kept = b->history + run[l] * b->rows * HS_KEPT;
    for (int i = 0; i < HS_SUM; ++i) found[i] = AT(sum, i, l);
    for (int i = 0; i < HS_MAX; ++i) found[HS_SUM + i] = AT(max, i, l);
    for (int i = 0; i < HS_MIN; ++i) found[HS_SUM + HS_MAX + i] = AT(min, i, l);
    if (!lost[l] && (hs_lost(found, HS_SUM) || hs_lost(found + HS_SUM + HS_MAX + HS_MIN, HS_LAST))) lost[l] = c[l]->n;
    b->lost[run[l]] = (int)lost[l];
    b->unsolved[run[l]] = g.unsolved[l];
    if (!lost[l]) continue;
    for (int i = 0; i < HS_FOUND; ++i) found[i] = NAN;
    for (long i = 0; i < c[l]->n * HS_KEPT; ++i) kept[i] = NAN;
  }
}
