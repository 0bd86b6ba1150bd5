/* What an FMU does, apart from the names that a version of the standard gives to it.

   Included by fmi2.c and fmi3.c, which define Status, Logger, OK, ERROR and `emit`.  model.h is generated: the step, the
   table of variables, the relations between parameters and, in the self-contained form, the cycle.  A value reference is
   a position in that table.  C99, and C++ as well.

   The step runs on a grid of constant length that begins at the start time.  A communication step advances the grid as
   far as its end reaches, by none, one or many internal steps; between them the outputs are held. */

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  const char *name, *unit, *allowed; /* the unit behind a blank, or nothing; the bounds in words */
  double start, lowest, highest;
  int state; /* position of the state that an output shows, or -1 */
} Variable;

typedef struct {
  const char *message; /* what is wrong when the relation is broken; null ends the list */
  int parameter[4];    /* whose values the message has */
} Relation;

#include "model.h"

/* Value references; the rest of the table is outputs. */
enum { TIME, REQUEST, GRADE, KEY_ON, STEP_SIZE, PARAMETERS, OUTPUTS = PARAMETERS + HS_NP, N_VARIABLES = OUTPUTS + HS_NY };

enum { INSTANTIATED = 1, INITIALIZING = 2, BEFORE_STEPPING = 3, STEPPING = 4, TERMINATED = 8, FAILED = 16 };

/* Times this part of an internal step apart are the same. */
#define TOLERANCE 1e-6

/* All that the past decides; saved and restored as one block. */
typedef struct {
  int64_t steps;         /* internal steps done */
  int32_t mode;
  int32_t sloped;        /* bit r: the input with reference r was given a time derivative for the next communication step */
  double slope[STEP_SIZE];
  double start_time, stop_time;
  double request;        /* requested speed at the end of the last communication step */
  double x[HS_NX];
  double value[N_VARIABLES];
} Memory;

typedef struct {
  char token[sizeof HS_TOKEN];
  Memory memory;
} Snapshot;

typedef struct {
  Memory memory;
  char *name;
  void *environment;
  Logger logger;
  int reporting;
} Instance;

/* Hand a message to the environment. */
static void emit(const Instance *c, const char *text);

#define MESSAGE 400

static void report(const Instance *c, const char *format, ...) {
  char text[MESSAGE];
  va_list arguments;
  if (!c || !c->logger || !c->reporting) return;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  emit(c, text);
}

static Status unsupported(void *instance, const char *function) {
  report((Instance *)instance, "%s is not supported", function);
  return ERROR;
}

/* Whether a function may be called now. */
static int allowed(const Instance *c, int modes, const char *function) {
  if (c && (c->memory.mode & modes)) return 1;
  report(c, "%s may not be called in this state of the instance", function);
  return 0;
}

/* Errors are reported unless this switches them off. */
static Status set_reporting(Instance *c, int on, size_t n, const char *const categories[]) {
  if (!c) return ERROR;
  for (size_t i = 0; i < n; ++i) {
    if (!categories || !categories[i] || strcmp(categories[i], "logStatusError")) {
      report(c, "unknown log category: %s", categories && categories[i] ? categories[i] : "none");
      return ERROR;
    }
  }
  c->reporting = on;
  return OK;
}

static Status reset(Instance *c) {
  if (!c) return ERROR;
  memset(&c->memory, 0, sizeof c->memory);
  c->memory.mode = INSTANTIATED;
  c->memory.stop_time = HUGE_VAL;
  for (int i = 0; i < N_VARIABLES; ++i) c->memory.value[i] = hs_variables[i].start;
  return OK;
}

static void destroy(Instance *c) {
  if (c) free(c->name);
  free(c);
}

/* Return a new instance, or null; `problem` is what the caller found wrong with the call, or null. */
static Instance *create(const char *name, const char *token, void *environment, Logger logger, int reporting, const char *problem) {
  Instance *c = (Instance *)calloc(1, sizeof *c);
  if (!c) return NULL;
  c->environment = environment;
  c->logger = logger;
  c->reporting = reporting;
  if (!name || !*name) problem = "the instance has no name";
  if (!token || strcmp(token, HS_TOKEN)) problem = "the token is not that of this FMU: modelDescription.xml and binary do not belong together";
  c->name = (char *)malloc(name ? strlen(name) + 1 : 1);
  if (c->name) strcpy(c->name, name ? name : "");
  if (problem || !c->name) {
    report(c, "not instantiated: %s", problem ? problem : "no memory");
    destroy(c);
    return NULL;
  }
  reset(c);
  return c;
}

/* Compute the start state and what is shown of it. */
static void start(Memory *m) {
  hs_start(m->value + PARAMETERS, m->x);
  m->value[TIME] = m->start_time;
  for (int i = OUTPUTS; i < N_VARIABLES; ++i) {
    int state = hs_variables[i].state;
    m->value[i] = state < 0 ? hs_variables[i].start : m->x[state];
  }
}

static Status set_times(Instance *c, double start_time, int has_stop_time, double stop_time, const char *function) {
  if (!allowed(c, INSTANTIATED, function)) return ERROR;
  if (!isfinite(start_time)) {
    report(c, "start time %g s: it must be a finite number", start_time);
    return ERROR;
  }
  if (has_stop_time && !(stop_time >= start_time)) {
    report(c, "stop time %g s: it must not be before the start time, %g s", stop_time, start_time);
    return ERROR;
  }
  c->memory.start_time = start_time;
  c->memory.stop_time = has_stop_time ? stop_time : HUGE_VAL;
  return OK;
}

static Status enter_initialization(Instance *c, const char *function) {
  if (!allowed(c, INSTANTIATED, function)) return ERROR;
  c->memory.mode = INITIALIZING;
  return OK;
}

/* Position of the first number that is not finite, or -1.  The first loop looks at several at a time. */
static int first_lost(const double *x, int n) {
  int lost = 0;
  for (int i = 0; i < n; ++i) lost |= !(fabs(x[i]) <= DBL_MAX);
  for (int i = 0; lost && i < n; ++i) {
    if (!isfinite(x[i])) return i;
  }
  return -1;
}

static Status exit_initialization(Instance *c, const char *function) {
  if (!allowed(c, INITIALIZING, function)) return ERROR;
  Memory *m = &c->memory;
  const double *p = m->value + PARAMETERS;
  int broken[sizeof hs_relations / sizeof *hs_relations];
  m->mode = STEPPING;
  hs_relate(p, broken);
  for (int i = 0; hs_relations[i].message; ++i) {
    const int *of = hs_relations[i].parameter;
    if (!broken[i]) continue;
    report(c, hs_relations[i].message, p[of[0]], p[of[1]], p[of[2]], p[of[3]]);
    m->mode = FAILED;
  }
  start(m);
  if (first_lost(m->x, HS_NX) >= 0) {
    report(c, "the start state is not a number; check the parameters");
    m->mode = FAILED;
  }
#ifdef HS_X_SPEED
  m->request = m->x[HS_X_SPEED];
#endif
  return m->mode == FAILED ? ERROR : OK;
}

static Status terminate(Instance *c, const char *function) {
  if (!allowed(c, INITIALIZING | STEPPING, function)) return ERROR;
  c->memory.mode = TERMINATED;
  return OK;
}

static Status get(Instance *c, const uint32_t reference[], size_t n, double value[]) {
  if (!c || (n && (!reference || !value))) return ERROR;
  if (c->memory.mode & BEFORE_STEPPING) start(&c->memory);
  for (size_t i = 0; i < n; ++i) {
    if (reference[i] >= N_VARIABLES) {
      report(c, "no variable has the value reference %u", (unsigned)reference[i]);
      return ERROR;
    }
    value[i] = c->memory.value[reference[i]];
  }
  return OK;
}

/* Whether a variable can be set to a value now; reports why not. */
static int settable(const Instance *c, uint32_t reference, double value) {
  const int mode = c->memory.mode;
  const int driven = HS_DRIVEN && reference >= REQUEST && reference <= KEY_ON;
  const int parameter = (HS_DRIVEN && reference == STEP_SIZE) || (reference >= PARAMETERS && reference < OUTPUTS);
  const Variable *v = &hs_variables[reference < N_VARIABLES ? reference : 0];
  const char *why = NULL;
  if (reference >= N_VARIABLES) {
    report(c, "no variable has the value reference %u", (unsigned)reference);
    return 0;
  }
  if (!driven && !parameter) why = "it is neither an input nor a parameter";
  else if (parameter && !(mode & BEFORE_STEPPING)) why = "it is a fixed parameter, which can be set only before the initialization ends";
  else if (!(mode & (BEFORE_STEPPING | STEPPING))) why = "the simulation has ended";
  if (why) {
    report(c, "%s cannot be set to %g%s: %s", v->name, value, v->unit, why);
    return 0;
  }
  if (!isfinite(value) || value < v->lowest || value > v->highest) {
    report(c, "%s = %g%s, must be %s", v->name, value, v->unit, *v->allowed ? v->allowed : "a finite number");
    return 0;
  }
  return 1;
}

/* Set all or, when one of them is refused, none. */
static Status set(Instance *c, const uint32_t reference[], size_t n, const double value[]) {
  int refused = 0;
  if (!c || (n && (!reference || !value))) return ERROR;
  for (size_t i = 0; i < n; ++i) refused |= !settable(c, reference[i], value[i]);
  if (refused) return ERROR;
  for (size_t i = 0; i < n; ++i) c->memory.value[reference[i]] = value[i];
  return OK;
}

#if HS_DRIVEN

/* Input at `time`, which lies in the communication step from t to t + h.  With a derivative it follows that, up to its
   bounds.  Without, the requested speed moves straight from its value before the step to the one set now, and the others
   are held; the value set now is met to the last bit at the end. */
static double input(const Memory *m, int reference, double time, double t, double h) {
  double now = m->value[reference];
  double part = time >= t + h - TOLERANCE * m->value[STEP_SIZE] ? h : time > t ? time - t : 0;
  if (m->sloped & 1 << reference) {
    const Variable *v = &hs_variables[reference];
    return fmax(v->lowest, fmin(v->highest, now + m->slope[reference] * part));
  }
  return reference != REQUEST || part == h ? now : m->request + (now - m->request) * part / h;
}

#else

#if HS_N_GRADE > 0
static double grade_at(double distance) {
  int low = 0, high = HS_N_GRADE - 1;
  if (distance <= hs_grade_distance[0]) return hs_grade_value[0];
  if (distance >= hs_grade_distance[high]) return hs_grade_value[high];
  while (high - low > 1) {
    int middle = (low + high) / 2;
    if (hs_grade_distance[middle] <= distance) low = middle; else high = middle;
  }
  return hs_grade_value[low] + (hs_grade_value[high] - hs_grade_value[low]) * (distance - hs_grade_distance[low])
         / (hs_grade_distance[high] - hs_grade_distance[low]);
}
#endif

/* Show the row of the cycle that belongs to the next internal step; the last row is held. */
static void read_cycle(Memory *m) {
  int row = m->steps < HS_N_CYCLE ? (int)m->steps : HS_N_CYCLE - 1;
  m->value[REQUEST] = hs_cycle[row][0];
  m->value[GRADE] = hs_cycle[row][1];
  m->value[KEY_ON] = hs_cycle[row][2];
#if HS_N_GRADE > 0
  m->value[GRADE] = grade_at(m->x[HS_X_DISTANCE]);
#endif
}

#endif

static Status do_step(Instance *c, double t, double h, const char *function) {
  if (!allowed(c, STEPPING, function)) return ERROR;
  Memory *m = &c->memory;
  const double length = m->value[STEP_SIZE], now = m->value[TIME];
  /* A master adds up its time, or multiplies; far from zero that alone may shift it. */
  const double slack = TOLERANCE * length + 4 * DBL_EPSILON * (fabs(t) + fabs(h));
  const double due = floor((t + h - m->start_time + slack) / length);
  if (!(fabs(t - now) <= slack)) {
    report(c, "a step from %.15g s is not possible: the instance is at %.15g s", t, now);
    return ERROR;
  }
  if (!(h > 0) || !(due < 9e15)) {
    report(c, "a step by %.15g s is not possible: its length must be > 0 s and finite", h);
    return ERROR;
  }
  if (t + h > m->stop_time + slack) {
    report(c, "a step from %.15g s by %.15g s is not possible: it goes past the stop time, %.15g s", t, h, m->stop_time);
    return ERROR;
  }
  double y[HS_NY], end = now;
  int lost = 0, stepped = 0;
  while (!lost && (double)m->steps < due) {
    double next[HS_NX], u[HS_NU] = {0};
    end = m->start_time + (double)(m->steps + 1) * length;
#if HS_DRIVEN
    for (int i = REQUEST; i <= KEY_ON; ++i) u[i - REQUEST] = input(m, i, end, t, h);
#else
    read_cycle(m);
    memcpy(u, m->value + REQUEST, 3 * sizeof *u);
#endif
    u[3] = length;
    lost = hs_step(m->x, u, m->value + PARAMETERS, next, y);
    memcpy(m->x, next, sizeof next);
    ++m->steps;
    stepped = 1;
  }
  if (stepped) {
    /* Only what will be seen has to be finite. */
    const int bad = first_lost(y, HS_NY);
    if (lost || bad >= 0) {
      report(c, "%s is not a number after the internal step that ends at %.15g s; check inputs and parameters",
             bad >= 0 ? hs_variables[OUTPUTS + bad].name : "a result", end);
      m->mode = FAILED;
      return ERROR;
    }
    memcpy(m->value + OUTPUTS, y, sizeof y);
  }
#if HS_DRIVEN
  m->request = input(m, REQUEST, t + h, t, h);
  m->sloped = 0;
#endif
  m->value[TIME] = t + h;
  return OK;
}

static Status save(Instance *c, void **state) {
  if (!c || !state) return ERROR;
  if (!*state) *state = calloc(1, sizeof(Snapshot));
  if (!*state) {
    report(c, "no memory for the state");
    return ERROR;
  }
  Snapshot *snapshot = (Snapshot *)*state;
  memcpy(snapshot->token, HS_TOKEN, sizeof HS_TOKEN);
  memcpy(&snapshot->memory, &c->memory, sizeof c->memory);
  return OK;
}

static Status restore(Instance *c, const void *state) {
  if (!c || !state) return ERROR;
  memcpy(&c->memory, &((const Snapshot *)state)->memory, sizeof c->memory);
  return OK;
}

static Status forget(Instance *c, void **state) {
  if (!c || !state) return ERROR;
  free(*state);
  *state = NULL;
  return OK;
}

static Status serialized_size(Instance *c, const void *state, size_t *size) {
  if (!c || !state || !size) return ERROR;
  *size = sizeof(Snapshot);
  return OK;
}

static Status serialize(Instance *c, const void *state, void *bytes, size_t size) {
  if (!c || !state || !bytes || size < sizeof(Snapshot)) {
    report(c, "no room for the serialized state");
    return ERROR;
  }
  memcpy(bytes, state, sizeof(Snapshot));
  return OK;
}

static Status deserialize(Instance *c, const void *bytes, size_t size, void **state) {
  if (!c || !bytes || !state) return ERROR;
  if (size != sizeof(Snapshot) || memcmp(bytes, HS_TOKEN, sizeof HS_TOKEN)) {
    report(c, "the serialized state is not one of this FMU");
    return ERROR;
  }
  if (!*state) *state = malloc(sizeof(Snapshot));
  if (!*state) {
    report(c, "no memory for the state");
    return ERROR;
  }
  memcpy(*state, bytes, sizeof(Snapshot));
  return OK;
}
