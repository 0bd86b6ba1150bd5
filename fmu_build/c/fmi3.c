/* The functions of FMI 3.0 for co-simulation; the others are there, as many tools look for them, and say that they are
   not supported. */

#include "fmi3Functions.h"

typedef fmi3Status Status;
typedef fmi3LogMessageCallback Logger;
#define OK fmi3OK
#define ERROR fmi3Error

#include "core.h"

#if defined(__GNUC__) /* the standard decides on the parameters */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

static void emit(const Instance *c, const char *text) {
  c->logger(c->environment, ERROR, "logStatusError", text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  return set_reporting((Instance *)c, on, n, categories);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean event_mode, fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                         size_t n_intermediate, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  return create(name, token, environment, log, logging, event_mode ? "event mode is not supported" : NULL);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  return create(name, token, environment, log, logging, "model exchange is not supported");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
  return create(name, token, environment, log, logging, "scheduled execution is not supported");
}

void fmi3FreeInstance(fmi3Instance c) { destroy((Instance *)c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start_time,
                                       fmi3Boolean has_stop_time, fmi3Float64 stop_time) {
  Status status = set_times((Instance *)c, start_time, has_stop_time, stop_time, "fmi3EnterInitializationMode");
  return status == OK ? enter_initialization((Instance *)c, "fmi3EnterInitializationMode") : status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return exit_initialization((Instance *)c, "fmi3ExitInitializationMode"); }

fmi3Status fmi3Terminate(fmi3Instance c) { return terminate((Instance *)c, "fmi3Terminate"); }

fmi3Status fmi3Reset(fmi3Instance c) { return reset((Instance *)c); }

/* Variables */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t n_value) {
  if (n == n_value) return get((Instance *)c, vr, n, value);
  report((Instance *)c, "fmi3GetFloat64: all variables are scalars");
  return ERROR;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t n_value) {
  if (n == n_value) return set((Instance *)c, vr, n, value);
  report((Instance *)c, "fmi3SetFloat64: all variables are scalars");
  return ERROR;
}

#define NO_VARIABLES(TYPE)                                                                                                      \
  fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE value[], size_t n_value) {       \
    return n ? unsupported(c, "fmi3Get" #TYPE) : OK;                                                                            \
  }                                                                                                                             \
  fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##TYPE value[], size_t n_value) { \
    return n ? unsupported(c, "fmi3Set" #TYPE) : OK;                                                                            \
  }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary value[], size_t n_value) {
  return n ? unsupported(c, "fmi3GetBinary") : OK;
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary value[], size_t n_value) {
  return n ? unsupported(c, "fmi3SetBinary") : OK;
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock value[]) {
  return n ? unsupported(c, "fmi3GetClock") : OK;
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock value[]) {
  return n ? unsupported(c, "fmi3SetClock") : OK;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
  return unsupported(c, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t dependent_elements[], fmi3ValueReference independents[],
                                       size_t independent_elements[], fmi3DependencyKind kinds[], size_t n) {
  return unsupported(c, "fmi3GetVariableDependencies");
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
                                        size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {
  return unsupported(c, "fmi3GetDirectionalDerivative");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
                                    size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {
  return unsupported(c, "fmi3GetAdjointDerivative");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[], fmi3Float64 value[],
                                    size_t n_value) {
  return n ? unsupported(c, "fmi3GetOutputDerivatives") : OK;
}

/* State */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return save((Instance *)c, state); }

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return restore((Instance *)c, state); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) { return forget((Instance *)c, state); }

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) { return serialized_size((Instance *)c, state, size); }

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) { return serialize((Instance *)c, state, bytes, size); }

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  return deserialize((Instance *)c, bytes, size, state);
}

/* Steps */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_rollback, fmi3Boolean *event, fmi3Boolean *terminate_simulation,
                      fmi3Boolean *early_return, fmi3Float64 *last_time) {
  Status status = do_step((Instance *)c, t, h, "fmi3DoStep");
  if (event) *event = fmi3False;
  if (terminate_simulation) *terminate_simulation = fmi3False;
  if (early_return) *early_return = fmi3False;
  if (c && last_time) *last_time = ((Instance *)c)->memory.value[TIME];
  return status;
}

/* Event mode, clocks, configuration, model exchange, scheduled execution */

#define NO_ARRAY(NAME, TYPE) \
  fmi3Status NAME(fmi3Instance c, TYPE value[], size_t n) { return unsupported(c, #NAME); }
#define NO_COUNT(NAME) \
  fmi3Status NAME(fmi3Instance c, size_t *n) { return unsupported(c, #NAME); }
#define NO_MODE(NAME) \
  fmi3Status NAME(fmi3Instance c) { return unsupported(c, #NAME); }

NO_MODE(fmi3EnterEventMode)
NO_MODE(fmi3EnterStepMode)
NO_MODE(fmi3EnterConfigurationMode)
NO_MODE(fmi3ExitConfigurationMode)
NO_MODE(fmi3EnterContinuousTimeMode)
NO_MODE(fmi3EvaluateDiscreteStates)
NO_ARRAY(fmi3SetContinuousStates, const fmi3Float64)
NO_ARRAY(fmi3GetContinuousStateDerivatives, fmi3Float64)
NO_ARRAY(fmi3GetEventIndicators, fmi3Float64)
NO_ARRAY(fmi3GetContinuousStates, fmi3Float64)
NO_ARRAY(fmi3GetNominalsOfContinuousStates, fmi3Float64)
NO_COUNT(fmi3GetNumberOfEventIndicators)
NO_COUNT(fmi3GetNumberOfContinuousStates)

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate_simulation, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next) {
  return unsupported(c, "fmi3UpdateDiscreteStates");
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_rollback, fmi3Boolean *event, fmi3Boolean *terminate_simulation) {
  return unsupported(c, "fmi3CompletedIntegratorStep");
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return unsupported(c, "fmi3SetTime"); }

fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[]) {
  return unsupported(c, "fmi3GetIntervalDecimal");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]) {
  return unsupported(c, "fmi3GetIntervalFraction");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[]) {
  return unsupported(c, "fmi3GetShiftDecimal");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
  return unsupported(c, "fmi3GetShiftFraction");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[]) {
  return unsupported(c, "fmi3SetIntervalDecimal");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[]) {
  return unsupported(c, "fmi3SetIntervalFraction");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[]) {
  return unsupported(c, "fmi3SetShiftDecimal");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[]) {
  return unsupported(c, "fmi3SetShiftFraction");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
  return unsupported(c, "fmi3ActivateModelPartition");
}
