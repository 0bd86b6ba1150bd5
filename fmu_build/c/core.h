/* What an FMU does, apart from the names that a version of the standard gives to it.

   Included by fmi2.c and fmi3.c, which define `emit`.  model.h is generated: the step, the table of variables and,
   in the self-contained form, the cycle.  A value reference is a position in that table.

   The step runs on a grid of constant length that begins at the start time.  A communication step advances the grid as
   far as its end reaches, by none, one or many internal steps; between them the outputs are held. */

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  const char *name;
  double start, lowest, highest;
  int state; /* position of the state that an output shows, or -1 */
} Variable;

#include "model.h"

/* Value references; the rest of the table is outputs. */
enum { TIME, REQUEST, GRADE, KEY_ON, STEP_SIZE, PARAMETERS, OUTPUTS = PARAMETERS + HS_NP, N_VARIABLES = OUTPUTS + HS_NY };

/* The same numbers in both versions of the standard. */
#define OK 0
#define ERROR 3

typedef enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16 } Mode;
enum { BEFORE_STEPPING = INSTANTIATED | INITIALIZING };

/* An internal step is due when it ends no more than this part of its length after the communication step. */
#define TOLERANCE 1e-6

/* All that the past decides; saved and restored as one block. */
typedef struct {
  int64_t steps;         /* internal steps done */
  int32_t mode;
  int32_t sloped;        /* bit r: the input with reference r was given a time derivative for the next communication step */
  double slope[STEP_SIZE];
  double start_time;
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
  void (*logger)(void); /* of the type that `emit` knows */
  int reporting;
} Instance;

/* Hand a message to the environment. */
static void emit(const Instance *c, const char *text);

static void report(const Instance *c, const char *format, ...) {
  char text[400];
  va_list arguments;
  if (!c || !c->logger || !c->reporting) return;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  emit(c, text);
}

static int unsupported(void *instance, const char *function) {
  report(instance, "%s is not supported", function);
  return ERROR;
}

/* Whether a function may be called now. */
static int allowed(const Instance *c, int modes, const char *function) {
  if (c && (c->memory.mode & modes)) return 1;
  report(c, "%s may not be called in this state of the instance", function);
  return 0;
}

/* Errors are reported unless this switches them off. */
static int set_reporting(Instance *c, int on, size_t n, const char *const categories[]) {
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

static int reset(Instance *c) {
  if (!c) return ERROR;
  memset(&c->memory, 0, sizeof c->memory);
  c->memory.mode = INSTANTIATED;
  for (int i = 0; i < N_VARIABLES; ++i) c->memory.value[i] = hs_variables[i].start;
  return OK;
}

static void destroy(Instance *c) {
  if (c) free(c->name);
  free(c);
}

/* Return a new instance, or null; `problem` is what the caller found wrong with the call, or null. */
static Instance *create(const char *name, const char *token, void *environment, void (*logger)(void), const char *problem) {
  Instance *c = calloc(1, sizeof *c);
  if (!c) return NULL;
  c->environment = environment;
  c->logger = logger;
  c->reporting = 1;
  if (!name || !*name) problem = "the instance has no name";
  if (!token || strcmp(token, HS_TOKEN)) problem = "the token is not that of this FMU: modelDescription.xml and binary do not belong together";
  c->name = malloc(name ? strlen(name) + 1 : 1);
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

static int set_start_time(Instance *c, double time, const char *function) {
  if (!allowed(c, INSTANTIATED, function)) return ERROR;
  if (!isfinite(time)) {
    report(c, "the start time is not a number");
    return ERROR;
  }
  c->memory.start_time = time;
  return OK;
}

static int enter_initialization(Instance *c, const char *function) {
  if (!allowed(c, INSTANTIATED, function)) return ERROR;
  c->memory.mode = INITIALIZING;
  return OK;
}

static int exit_initialization(Instance *c, const char *function) {
  if (!allowed(c, INITIALIZING, function)) return ERROR;
  Memory *m = &c->memory;
  start(m);
  m->mode = STEPPING;
  for (int i = 0; i < HS_NX; ++i) {
    if (!isfinite(m->x[i])) {
      report(c, "the start state is not a number; check the parameters");
      m->mode = FAILED;
      return ERROR;
    }
  }
#ifdef HS_X_SPEED
  m->request = m->x[HS_X_SPEED];
#endif
  return OK;
}

static int terminate(Instance *c, const char *function) {
  if (!allowed(c, INITIALIZING | STEPPING, function)) return ERROR;
  c->memory.mode = TERMINATED;
  return OK;
}

static int get(Instance *c, const uint32_t reference[], size_t n, double value[]) {
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

/* Return why a variable cannot be set now, or null. */
static const char *refusal(const Memory *m, uint32_t reference, double value) {
  const Variable *variable = &hs_variables[reference];
  int driven = HS_DRIVEN && reference >= REQUEST && reference <= KEY_ON;
  int parameter = (HS_DRIVEN && reference == STEP_SIZE) || (reference >= PARAMETERS && reference < OUTPUTS);
  if (!driven && !parameter) return "is neither an input nor a parameter";
  if (parameter && !(m->mode & BEFORE_STEPPING)) return "is a fixed parameter, which can be set only before the initialization ends";
  if (!(m->mode & (BEFORE_STEPPING | STEPPING))) return "can no longer be set";
  if (!isfinite(value)) return "must be a finite number";
  if (value < variable->lowest || value > variable->highest) return "is out of its bounds";
  return NULL;
}

/* Set all or, when one of them is refused, none. */
static int set(Instance *c, const uint32_t reference[], size_t n, const double value[]) {
  if (!c || (n && (!reference || !value))) return ERROR;
  for (size_t i = 0; i < n; ++i) {
    const char *why = reference[i] < N_VARIABLES ? refusal(&c->memory, reference[i], value[i]) : "does not exist";
    if (why) {
      const char *name = reference[i] < N_VARIABLES ? hs_variables[reference[i]].name : "a variable";
      report(c, "%s (value reference %u) = %g: it %s", name, (unsigned)reference[i], value[i], why);
      return ERROR;
    }
  }
  for (size_t i = 0; i < n; ++i) {
    c->memory.value[reference[i]] = value[i];
    if (reference[i] < STEP_SIZE) c->memory.sloped &= ~(1 << reference[i]);
  }
  return OK;
}

#if HS_DRIVEN

/* Input at `time`, which lies in the communication step from t to t + h.  With a derivative it follows that.  Without,
   the requested speed moves straight from its value before the step to the one set now, and the others are held; the
   value set now is met to the last bit at the end. */
static double input(const Memory *m, int reference, double time, double t, double h) {
  double now = m->value[reference];
  double part = time >= t + h - TOLERANCE * m->value[STEP_SIZE] ? h : time > t ? time - t : 0;
  if (m->sloped & 1 << reference) return now + m->slope[reference] * part;
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

static int do_step(Instance *c, double t, double h, const char *function) {
  if (!allowed(c, STEPPING, function)) return ERROR;
  Memory *m = &c->memory;
  double length = m->value[STEP_SIZE];
  double due = floor((t + h - m->start_time) / length + TOLERANCE);
  if (!(h >= 0) || !(fabs(due) < 9e15)) {
    report(c, "a step from %g s by %g s is not possible", t, h);
    return ERROR;
  }
  while ((double)m->steps < due) {
    double next[HS_NX], u[HS_NU] = {0};
    double end = m->start_time + (double)(m->steps + 1) * length;
#if HS_DRIVEN
    for (int i = REQUEST; i <= KEY_ON; ++i) u[i - REQUEST] = input(m, i, end, t, h);
#else
    read_cycle(m);
    memcpy(u, m->value + REQUEST, 3 * sizeof *u);
#endif
    u[3] = length;
    if (hs_step(m->x, u, m->value + PARAMETERS, next, m->value + OUTPUTS)) {
      report(c, "a result of the internal step that ends at %.15g s is not a number; check inputs and parameters", end);
      m->mode = FAILED;
      return ERROR;
    }
    memcpy(m->x, next, sizeof next);
    ++m->steps;
  }
#if HS_DRIVEN
  m->request = input(m, REQUEST, t + h, t, h);
  m->sloped = 0;
#endif
  m->value[TIME] = t + h;
  return OK;
}

static int save(Instance *c, void **state) {
  if (!c || !state) return ERROR;
  if (!*state) *state = calloc(1, sizeof(Snapshot));
  if (!*state) {
    report(c, "no memory for the state");
    return ERROR;
  }
  Snapshot *snapshot = *state;
  memcpy(snapshot->token, HS_TOKEN, sizeof HS_TOKEN);
  memcpy(&snapshot->memory, &c->memory, sizeof c->memory);
  return OK;
}

static int restore(Instance *c, const void *state) {
  if (!c || !state) return ERROR;
  memcpy(&c->memory, &((const Snapshot *)state)->memory, sizeof c->memory);
  return OK;
}

static int forget(Instance *c, void **state) {
  if (!c || !state) return ERROR;
  free(*state);
  *state = NULL;
  return OK;
}

static int serialized_size(Instance *c, const void *state, size_t *size) {
  if (!c || !state || !size) return ERROR;
  *size = sizeof(Snapshot);
  return OK;
}

static int serialize(Instance *c, const void *state, void *bytes, size_t size) {
  if (!c || !state || !bytes || size < sizeof(Snapshot)) {
    report(c, "no room for the serialized state");
    return ERROR;
  }
  memcpy(bytes, state, sizeof(Snapshot));
  return OK;
}

static int deserialize(Instance *c, const void *bytes, size_t size, void **state) {
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
