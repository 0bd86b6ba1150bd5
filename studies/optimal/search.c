/* Forward dynamic programming on the step itself, many vehicles in lockstep.  Included after march.c, and where there are lanes after the
   step in lanes.

   A node is one vehicle with its whole state.  In each step of the trace every node is stepped with every candidate of the commands; of
   those that arrive in the same slot the one of the least cost is kept:

       slot = family, what the controls remember (run, gear), place of the charge between `low` and `high`
       cost = fuel - price of the family * (energy gained by store and rotors - energy that the method made of nothing)    [J]

   With one family and many places that is dynamic programming over the charge; with many families and one place, minimum search by
   Lagrange: the charge has a price, and only what the controls remember is looked ahead for.  Dropped is what is slower or faster than it
   may be, or has a charge outside.  Of equal costs the first node and the first candidate count, so that threads change nothing. */

#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LINED __attribute__((aligned(64)))
#define COMMANDS (HS_NU - 5)
enum { KEPT = 16 };

#ifdef HS_BLOCKS
#define PREPARE(j, q, l) hs_prepare_lane((j)->p, (q) + (l))
/* Compiled once. */
__attribute__((noinline)) static void step_lanes(const double *x, const double *u, const double *w, const double *q, double *xn, double *y) {
  hs_step_lanes(x, u, w, q, xn, y);
}
#define STEP(j, x, u, w, q, xn, y) step_lanes(x, u, w, q, xn, y)
#else
#define HS_LANES 1
#define HS_NL HS_NQ
#define HS_NW 1
#define PREPARE(j, q, l) hs_prepare((j)->p, q)
#define STEP(j, x, u, w, q, xn, y) hs_step_prepared(x, u, (j)->p, q, xn, y)
static void hs_prepare_cycle(const double *u, double *w) { (void)u; w[0] = 0; }
#endif

/* Value `i` of lane `l`. */
#define AT(a, i, l) ((a)[(i) * HS_LANES + (l)])
/* Value `i` of node `m`, of nodes that lie in groups. */
#define OF(a, i, m) ((a)[((m) / HS_LANES * HS_NX + (i)) * HS_LANES + (m) % HS_LANES])

typedef struct {
  long n;
  const double *dt, *v, *grade, *key_on;
  long n_grade;
  const double *grade_distance, *grade_value;
  const double *p, *x;       /* parameters, and the state that all begin with */
  long candidates;
  const double *commands;    /* COMMANDS a candidate, for each step */
  const int *kind;           /* of each candidate; nodes that the last command left differently are told apart */
  long kinds, families, places;
  const double *price;       /* of each family, in each step: fuel for the energy that is held [1] */
  double bend;               /* by how much less of itself a price is for each joule held beyond `plan` [1/J] */
  const double *plan;        /* after each step [J] */
  const double *low, *high, *slowest, *fastest; /* after each step */
  long at_charge, fuels;
  const int *at_fuel;        /* states */
  const double *heating;     /* of each fuel [J/kg] */
  long powers, errors;
  const int *at_power, *at_error; /* outputs: powers that are held, and those that the method loses [W] */
  const double *worth;       /* of each of these powers, and of the errors, over the store's [1] */
  long memories;
  const int *at_memory;      /* states that hold whole numbers, told apart up to KEPT */
  /* What is found: of each step how many nodes there are, which node each comes from and by which candidate. */
  long most;
  int *count, *from;
  short *by;
  double *end;               /* of each node at the end: family, fuel [J], charge */
  long dead;                 /* the step that nothing survives, from 1; 0 where there is none */
} search_job;

typedef struct { double cost; int from, by; } arrival;

typedef struct {
  search_job *job;
  long slots, threads, next, nodes;
  double *now, *then;        /* states of nodes */
  int *family, *family_then;
  double *held, *held_then;  /* energy gained since the start, by its worth [J] */
  arrival *best;             /* of each thread, by slot */
  int *winner;               /* slots that something arrived in */
  pthread_mutex_t lock;
  pthread_cond_t all;
  long waiting, round;
  int lost;
} search_state;

typedef struct { search_state *s; long number; } worker;

/* Wait until all threads have come here. */
static void meet(search_state *s) {
  pthread_mutex_lock(&s->lock);
  const long round = s->round;
  if (++s->waiting == s->threads) {
    s->waiting = 0;
    ++s->round;
    pthread_cond_broadcast(&s->all);
  }
  while (round == s->round) pthread_cond_wait(&s->all, &s->lock);
  pthread_mutex_unlock(&s->lock);
}

/* Return memory for `n` numbers that vectors can be read from; `*whole` is what must be freed. */
static double *lined(size_t n, void **whole) {
  *whole = malloc(n * sizeof(double) + 64);
  return *whole ? (double *)(((uintptr_t)*whole + 63) / 64 * 64) : NULL;
}

static double fuel_of(const search_job *j, const double *x, int l) {
  double fuel = 0;
  for (long i = 0; i < j->fuels; ++i) fuel += j->heating[i] * AT(x, j->at_fuel[i], l);
  return fuel;
}

/* Everything here is done for all lanes by the compiler. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3")
#endif

/* Find the energy that each lane holds after a step. */
static void hold(const search_job *j, long k, const double *y, const double *before, double *held) {
  const double dt = j->dt[k];
  double P[HS_LANES] = {0};
  for (long i = 0; i < j->powers + j->errors; ++i) {
    const double *own = &AT(y, i < j->powers ? j->at_power[i] : j->at_error[i - j->powers], 0), worth = j->worth[i];
    const double most = i < j->powers ? HUGE_VAL : 0;
    for (int l = 0; l < HS_LANES; ++l) P[l] += worth * (own[l] < most ? own[l] : most);
  }
  for (int l = 0; l < HS_LANES; ++l) held[l] = before[l] + dt * P[l];
}

/* Give what lane `l` is asked for in step `k`, with a candidate; `u` and `w` are those of the candidate on a level road. */
static void ask(const search_job *j, const double *x, const double *own, double *u, double *w, int l) {
  double at[HS_NU], followed[HS_NW];
  const double *from_u = own, *from_w = own + HS_NU;
  if (j->n_grade) {
    memcpy(at, own, sizeof at);
    at[1] = grade_at(AT(x, HS_X_DISTANCE, l), j->n_grade, j->grade_distance, j->grade_value);
    hs_prepare_cycle(at, followed);
    from_u = at, from_w = followed;
  }
  for (int i = 0; i < HS_NU; ++i) AT(u, i, l) = from_u[i];
  for (int i = 0; i < HS_NW; ++i) AT(w, i, l) = from_w[i];
}

static void ask_all(const search_job *j, const double *x, const double *own, double *u, double *w) {
  if (j->n_grade || HS_LANES == 1) {
    for (int l = 0; l < HS_LANES; ++l) ask(j, x, own, u, w, l);
    return;
  }
#ifdef HS_BLOCKS
  /* Read as vectors, they come sooner if they were written so. */
  for (int i = 0; i < HS_NU + HS_NW; ++i) {
    double *to = i < HS_NU ? &AT(u, i, 0) : &AT(w, i - HS_NU, 0);
    for (int b = 0; b < HS_BLOCKS; ++b) v_store(to + b * W, v_set(own[i]));
  }
#endif
}

/* Find the slot in which each lane arrives, or -1, and at what cost. */
static void arrive(const search_job *j, long k, double scale, const double *x, const double *y, const int *family, const double *held,
                   int kind, int *slot, double *cost) {
  const double slowest = j->slowest[k], fastest = j->fastest[k], low = j->low[k], high = j->high[k];
  const int places = (int)j->places, kinds = (int)j->kinds;
  const double *price = j->price + k * j->families, *v = &AT(x, HS_X_V, 0), *charge = &AT(x, j->at_charge, 0);
  double after[HS_LANES];
  hold(j, k, y, held, after);
  for (int l = 0; l < HS_LANES; ++l) {
    slot[l] = family[l] * kinds + kind;
    cost[l] = 0;
  }
  for (long i = 0; i < j->memories; ++i) {
    const double *memory = &AT(x, j->at_memory[i], 0);
    for (int l = 0; l < HS_LANES; ++l) slot[l] = slot[l] * KEPT + ((int)(memory[l] + 0.5) & (KEPT - 1));
  }
  for (long i = 0; i < j->fuels; ++i) {
    const double *fuel = &AT(x, j->at_fuel[i], 0), heating = j->heating[i];
    for (int l = 0; l < HS_LANES; ++l) cost[l] += heating * fuel[l];
  }
  for (int l = 0; l < HS_LANES; ++l) {
    const int able = (v[l] >= slowest) & (v[l] <= fastest) & (charge[l] >= low) & (charge[l] <= high);
    int place = (int)((charge[l] - low) * scale);
    place = place < places ? place : places - 1;
    slot[l] = able ? slot[l] * places + place : -1;
    const double beyond = after[l] - j->plan[k];
    cost[l] -= price[family[l]] * (after[l] - 0.5 * j->bend * beyond * beyond);
  }
}

/* Step a group of nodes with all candidates, and note what arrives where. */
static void spread(search_state *s, long k, long group, const double *asked, const double *q, arrival *best) {
  const search_job *j = s->job;
  const double *x = s->now + group * HS_NX * HS_LANES, scale = (double)j->places / (j->high[k] - j->low[k]);
  double u[HS_NU * HS_LANES] LINED, w[HS_NW * HS_LANES] LINED, xn[HS_NX * HS_LANES] LINED, y[HS_NY * HS_LANES] LINED;
  double cost[HS_LANES];
  int slot[HS_LANES];
  const long first = group * HS_LANES, lanes = s->nodes - first < HS_LANES ? s->nodes - first : HS_LANES;
  for (long c = 0; c < j->candidates; ++c) {
    ask_all(j, x, asked + c * (HS_NU + HS_NW), u, w);
    STEP(j, x, u, w, q, xn, y);
    arrive(j, k, scale, xn, y, s->family + first, s->held + first, j->kind[c], slot, cost);
    for (int l = 0; l < lanes; ++l) {
      if (slot[l] < 0) continue;
      const int from = (int)first + l;
      arrival *a = best + slot[l];
      /* Of equal ones the first node and the first candidate. */
      if (cost[l] > a->cost || (cost[l] == a->cost && (from > a->from || (from == a->from && c > a->by)))) continue;
      *a = (arrival){cost[l], from, (int)c};
    }
  }
}

/* Choose of what all threads found. */
static void choose(search_state *s, long k) {
  search_job *j = s->job;
  long n = 0;
  for (long t = 1; t < s->threads; ++t) {
    for (long slot = 0; slot < s->slots; ++slot) {
      arrival *a = s->best + slot;
      const arrival b = s->best[t * s->slots + slot];
      if (b.cost < a->cost || (b.cost == a->cost && (b.from < a->from || (b.from == a->from && b.by < a->by)))) *a = b;
    }
  }
  for (long slot = 0; slot < s->slots; ++slot) {
    const arrival a = s->best[slot];
    if (a.cost == HUGE_VAL) continue;
    j->from[k * j->most + n] = a.from;
    j->by[k * j->most + n] = (short)a.by;
    s->family_then[n++] = s->family[a.from];
  }
  j->count[k] = (int)n;
}

/* Step what was chosen once more, and keep it: a group of the nodes after step `k`. */
static void settle(search_state *s, long k, long group, const double *asked, const double *q) {
  const search_job *j = s->job;
  double x[HS_NX * HS_LANES] LINED, u[HS_NU * HS_LANES] LINED, w[HS_NW * HS_LANES] LINED, y[HS_NY * HS_LANES] LINED, before[HS_LANES];
  for (int l = 0; l < HS_LANES; ++l) {
    /* The last group is filled up with its last node. */
    const long m = group * HS_LANES + l < j->count[k] ? group * HS_LANES + l : j->count[k] - 1;
    const long from = j->from[k * j->most + m];
    before[l] = s->held[from];
    for (int i = 0; i < HS_NX; ++i) AT(x, i, l) = OF(s->now, i, from);
    ask(j, x, asked + j->by[k * j->most + m] * (HS_NU + HS_NW), u, w, l);
  }
  STEP(j, x, u, w, q, s->then + group * HS_NX * HS_LANES, y);
  hold(j, k, y, before, s->held_then + group * HS_LANES);
}

static void *work(void *given) {
  search_state *s = ((worker *)given)->s;
  const long number = ((worker *)given)->number;
  search_job *j = s->job;
  const long width = HS_NU + HS_NW;
  double q[HS_NL * HS_LANES] LINED;
  /* Until it is known how many threads there are. */
  pthread_mutex_lock(&s->lock);
  pthread_mutex_unlock(&s->lock);
  double *asked = malloc(sizeof(double) * j->candidates * width);
  arrival *best = s->best + number * s->slots;
  int lost = !asked;
  for (int l = 0; l < HS_LANES; ++l) lost |= PREPARE(j, q, l);
  if (lost) __atomic_store_n(&s->lost, 1, __ATOMIC_RELAXED);
  meet(s);
  for (long k = 0; k < j->n && !s->lost && !j->dead; ++k) {
    for (long c = 0; c < j->candidates; ++c) {
      double *u = asked + c * width;
      const double plain[5] = {j->v[k], j->n_grade ? 0 : j->grade[k], j->key_on[k], j->dt[k], 0};
      memcpy(u, plain, sizeof plain);
      memcpy(u + 5, j->commands + (k * j->candidates + c) * COMMANDS, COMMANDS * sizeof(double));
      hs_prepare_cycle(u, u + HS_NU);
    }
    for (long i = 0; i < s->slots; ++i) best[i] = (arrival){HUGE_VAL, 0, 0};
    for (long g; (g = __atomic_fetch_add(&s->next, 1, __ATOMIC_RELAXED)) * HS_LANES < s->nodes;) spread(s, k, g, asked, q, best);
    meet(s);
    if (!number) {
      choose(s, k);
      s->next = 0;
    }
    meet(s);
    for (long g; (g = __atomic_fetch_add(&s->next, 1, __ATOMIC_RELAXED)) * HS_LANES < j->count[k];) settle(s, k, g, asked, q);
    meet(s);
    if (!number) {
      double *swap = s->now; s->now = s->then; s->then = swap;
      swap = s->held; s->held = s->held_then; s->held_then = swap;
      int *other = s->family; s->family = s->family_then; s->family_then = other;
      s->nodes = j->count[k];
      s->next = 0;
      if (!s->nodes) j->dead = k + 1;
    }
    meet(s);
  }
  free(asked);
  return NULL;
}

/* Search on some threads, of which the caller's is one.  Returns whether it was done: 1 where a parameter is no number, -1 where there is no
   memory. */
HS_EXPORT int hs_search(search_job *j, int threads) {
  search_state s = {.job = j};
  const long groups = j->most / HS_LANES + 1;
  void *whole[2];
  worker workers[64];
  pthread_t others[64];
  int result = -1, started = 0;
  threads = threads > 64 ? 64 : threads;
  s.slots = j->families * j->kinds * j->places;
  for (long i = 0; i < j->memories; ++i) s.slots *= KEPT;
  s.nodes = j->families;
  s.now = lined((size_t)groups * HS_NX * HS_LANES, whole);
  s.then = lined((size_t)groups * HS_NX * HS_LANES, whole + 1);
  s.family = calloc(j->most + HS_LANES, sizeof(int));
  s.family_then = calloc(j->most + HS_LANES, sizeof(int));
  s.held = calloc(j->most + HS_LANES, sizeof(double));
  s.held_then = calloc(j->most + HS_LANES, sizeof(double));
  s.best = malloc(sizeof(arrival) * s.slots * threads);
  if (s.now && s.then && s.family && s.family_then && s.held && s.held_then && s.best) {
    for (long m = 0; m < groups * HS_LANES; ++m) {
      for (int i = 0; i < HS_NX; ++i) OF(s.now, i, m) = j->x[i];
    }
    for (long m = 0; m < j->families; ++m) s.family[m] = (int)m;
    pthread_mutex_init(&s.lock, NULL);
    pthread_cond_init(&s.all, NULL);
    pthread_mutex_lock(&s.lock);
    for (int t = 0; t < threads; ++t) workers[t] = (worker){&s, t};
    while (started < threads - 1 && !pthread_create(others + started, NULL, work, workers + started + 1)) ++started;
    s.threads = started + 1;
    pthread_mutex_unlock(&s.lock);
    work(workers);
    while (started) pthread_join(others[--started], NULL);
    pthread_cond_destroy(&s.all);
    pthread_mutex_destroy(&s.lock);
    result = s.lost;
    for (long m = 0; !j->dead && m < s.nodes; ++m) {
      double x[HS_NX * HS_LANES];
      for (int i = 0; i < HS_NX; ++i) AT(x, i, 0) = OF(s.now, i, m);
      j->end[3 * m] = s.family[m];
      j->end[3 * m + 1] = fuel_of(j, x, 0);
      j->end[3 * m + 2] = AT(x, j->at_charge, 0);
    }
  }
  free(whole[0]); free(whole[1]); free(s.family); free(s.family_then); free(s.held); free(s.held_then); free(s.best);
  return result;
}
