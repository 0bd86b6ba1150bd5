/* The functions of FMI 2.0 for co-simulation; those of model exchange are there, as many tools look for them, and say
   that they are not supported. */

#include "fmi2Functions.h"

typedef fmi2Status Status;
typedef fmi2CallbackLogger Logger;
#define OK fmi2OK
#define ERROR fmi2Error

#include "core.h"

#if defined(__GNUC__) /* the standard decides on the parameters */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

/* The standard has a format here, but many tools show it as it is: no placeholders. */
static void emit(const Instance *c, const char *text) {
  char format[2 * MESSAGE], *end = format;
  for (; *text; ++text) {
    if (*text == '%') *end++ = '%';
    *end++ = *text;
  }
  *end = 0;
  c->logger(c->environment, c->name, ERROR, "logStatusError", format);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  return set_reporting((Instance *)c, on, n, categories);
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
  const char *problem = type == fmi2CoSimulation ? NULL : "model exchange is not supported";
  return create(name, guid, functions ? functions->componentEnvironment : NULL, functions ? functions->logger : NULL, logging, problem);
}

void fmi2FreeInstance(fmi2Component c) { destroy((Instance *)c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start_time,
                               fmi2Boolean has_stop_time, fmi2Real stop_time) {
  return set_times((Instance *)c, start_time, has_stop_time, stop_time, "fmi2SetupExperiment");
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return enter_initialization((Instance *)c, "fmi2EnterInitializationMode"); }

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return exit_initialization((Instance *)c, "fmi2ExitInitializationMode"); }

fmi2Status fmi2Terminate(fmi2Component c) { return terminate((Instance *)c, "fmi2Terminate"); }

fmi2Status fmi2Reset(fmi2Component c) { return reset((Instance *)c); }

/* Variables */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) { return get((Instance *)c, vr, n, value); }

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) { return set((Instance *)c, vr, n, value); }

#define NO_VARIABLES(TYPE)                                                                                                \
  fmi2Status fmi2Get##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##TYPE value[]) {                \
    return n ? unsupported(c, "fmi2Get" #TYPE) : OK;                                                                      \
  }                                                                                                                       \
  fmi2Status fmi2Set##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##TYPE value[]) {          \
    return n ? unsupported(c, "fmi2Set" #TYPE) : OK;                                                                      \
  }

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

/* Derivatives count for the next communication step. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
  Instance *instance = (Instance *)c;
  if (!allowed(instance, BEFORE_STEPPING | STEPPING, "fmi2SetRealInputDerivatives") || (n && (!vr || !order || !value))) return ERROR;
  for (size_t i = 0; i < n; ++i) {
    if (!HS_DRIVEN || vr[i] < REQUEST || vr[i] > KEY_ON || order[i] != 1 || !isfinite(value[i])) {
      report(instance, "derivative of order %d of value reference %u = %g: inputs have finite derivatives of order 1", order[i], vr[i], value[i]);
      return ERROR;
    }
  }
  for (size_t i = 0; i < n; ++i) {
    instance->memory.slope[vr[i]] = value[i];
    instance->memory.sloped |= 1 << vr[i];
  }
  return OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
  return n ? unsupported(c, "fmi2GetRealOutputDerivatives") : OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown, const fmi2ValueReference known[],
                                        size_t n_known, const fmi2Real seed[], fmi2Real sensitivity[]) {
  return unsupported(c, "fmi2GetDirectionalDerivative");
}

/* State */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return save((Instance *)c, state); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return restore((Instance *)c, state); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { return forget((Instance *)c, state); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) { return serialized_size((Instance *)c, state, size); }

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) { return serialize((Instance *)c, state, bytes, size); }

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  return deserialize((Instance *)c, bytes, size, state);
}

/* Steps */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_rollback) { return do_step((Instance *)c, t, h, "fmi2DoStep"); }

fmi2Status fmi2CancelStep(fmi2Component c) { return unsupported(c, "fmi2CancelStep"); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { return fmi2Discard; }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  if (!c || !value || kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = ((Instance *)c)->memory.value[TIME];
  return OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { return fmi2Discard; }

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  if (!c || !value || kind != fmi2Terminated) return fmi2Discard;
  *value = fmi2False;
  return OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { return fmi2Discard; }

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return unsupported(c, "fmi2EnterEventMode"); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) { return unsupported(c, "fmi2NewDiscreteStates"); }

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return unsupported(c, "fmi2EnterContinuousTimeMode"); }

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_rollback, fmi2Boolean *event, fmi2Boolean *terminate_simulation) {
  return unsupported(c, "fmi2CompletedIntegratorStep");
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return unsupported(c, "fmi2SetTime"); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { return unsupported(c, "fmi2SetContinuousStates"); }

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { return unsupported(c, "fmi2GetDerivatives"); }

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return unsupported(c, "fmi2GetEventIndicators"); }

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return unsupported(c, "fmi2GetContinuousStates"); }

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  return unsupported(c, "fmi2GetNominalsOfContinuousStates");
}
