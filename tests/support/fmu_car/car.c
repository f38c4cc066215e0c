/* A linear single-track car as an FMU for model exchange: states x, y, psi, beta, r; parameters as in `Vehicle`. */
#include <math.h>
#include <stdlib.h>
#include "fmi2FunctionTypes.h" /* not fmi2Functions.h, whose prototypes the unused functions below do not keep */

#define fmi2Version "2.0"

enum { X, Y, PSI, BETA, R, DX, DY, DPSI, DBETA, DR, STEER, SPEED, A_Y, M, I_Z, L_F, L_R, C_F, C_R, RATIO, ALL };
typedef double Car[ALL];

static void derive(double *c)
{
  const double delta = c[STEER] / c[RATIO], v = c[SPEED];
  const double front = c[C_F] * (delta - c[BETA] - c[L_F] * c[R] / v), rear = c[C_R] * (c[L_R] * c[R] / v - c[BETA]);
  c[DX] = v * cos(c[PSI] + c[BETA]);
  c[DY] = v * sin(c[PSI] + c[BETA]);
  c[DPSI] = c[R];
  c[DBETA] = (front + rear) / (c[M] * v) - c[R];
  c[DR] = (c[L_F] * front - c[L_R] * rear) / c[I_Z];
  c[A_Y] = v * (c[R] + c[DBETA]);
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{ return calloc(1, sizeof(Car)); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real t, fmi2Boolean s, fmi2Real u)
{ return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e)
{ e->newDiscreteStatesNeeded = fmi2False; e->terminateSimulation = fmi2False; return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{ for (size_t i = 0; i < n; i++) ((double *)c)[i] = x[i]; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{ for (size_t i = 0; i < n; i++) x[i] = ((double *)c)[i]; return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{ derive(c); for (size_t i = 0; i < n; i++) dx[i] = ((double *)c)[DX + i]; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{ derive(c); for (size_t i = 0; i < n; i++) value[i] = ((double *)c)[vr[i]]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{ for (size_t i = 0; i < n; i++) ((double *)c)[vr[i]] = value[i]; return fmi2OK; }

/* what this car has no use for, but a loader looks up */
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no, fmi2Boolean *event, fmi2Boolean *end)
{ *event = *end = fmi2False; return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{ for (size_t i = 0; i < n; i++) x[i] = 1.0; return fmi2OK; }
#define UNUSED(name) fmi2Status name() { return fmi2Error; }
#define fmi2_(name) UNUSED(fmi2##name)
fmi2_(SetDebugLogging) fmi2_(Reset) fmi2_(GetInteger) fmi2_(GetBoolean) fmi2_(GetString) fmi2_(SetInteger)
fmi2_(SetBoolean) fmi2_(SetString) fmi2_(GetFMUstate) fmi2_(SetFMUstate) fmi2_(FreeFMUstate)
fmi2_(SerializedFMUstateSize) fmi2_(SerializeFMUstate) fmi2_(DeSerializeFMUstate) fmi2_(GetDirectionalDerivative)
fmi2_(EnterEventMode) fmi2_(GetEventIndicators)
