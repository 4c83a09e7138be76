/* The functions of FMI 3.0 for co-simulation. The standard: https://fmi-standard.org; types and names are its own. */

#include "fmu.h"

#include <stdlib.h>
#include <string.h>

#ifdef FMI3_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define JOIN(prefix, name) JOINED(prefix, name)
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } status_t;
typedef void (*logger_t)(void *, status_t, const char *, const char *);
typedef void (*other_t)(void);
typedef uint32_t ref_t;
typedef struct {
    fmu_data data;
    logger_t logger;
    void *environment;
} instance_t;

static status_t refused(instance_t *one, const char *why)
{
    if (one->logger != NULL) {
        one->logger(one->environment, ERROR, "logStatusError", why);
    }
    return ERROR;
}

/* A function: it is declared and then defined. */
#define FUNCTION(type, name, parameters)                                                                               \
    EXPORT type FMI(name) parameters;                                                                                  \
    EXPORT type FMI(name) parameters

/* --- creation */

FUNCTION(const char *, fmi3GetVersion, (void))
{
    return "3.0";
}

FUNCTION(status_t, fmi3SetDebugLogging, (void *c, bool is_on, size_t count, const char *const categories[]))
{
    return OK;
}

FUNCTION(void *, fmi3InstantiateCoSimulation,
         (const char *name, const char *token, const char *resources, bool is_visible, bool is_logging,
          bool has_events, bool may_return_early, const ref_t between[], size_t between_count, void *environment,
          logger_t logger, other_t update))
{
    instance_t *one = (instance_t *)calloc(1, sizeof(instance_t));
    if (one == NULL) {
        return NULL;
    }
    one->logger = logger;
    one->environment = environment;
    if (token == NULL || strcmp(token, FMU_TOKEN) != 0) {
        (void)refused(one, "this binary belongs to a model description with the token " FMU_TOKEN);
        free(one);
        return NULL;
    }
    fmu_start(&one->data);
    return one;
}

FUNCTION(void *, fmi3InstantiateModelExchange,
         (const char *name, const char *token, const char *resources, bool is_visible, bool is_logging,
          void *environment, logger_t logger))
{
    return NULL;
}

FUNCTION(void *, fmi3InstantiateScheduledExecution,
         (const char *name, const char *token, const char *resources, bool is_visible, bool is_logging,
          void *environment, logger_t logger, other_t update, other_t lock, other_t unlock))
{
    return NULL;
}

FUNCTION(void, fmi3FreeInstance, (void *c))
{
    free(c);
}

/* --- modes */

FUNCTION(status_t, fmi3EnterInitializationMode,
         (void *c, bool has_tolerance, double tolerance, double start, bool has_stop, double stop))
{
    ((instance_t *)c)->data.start_time = start;
    ((instance_t *)c)->data.reals[0] = start;
    return OK;
}

FUNCTION(status_t, fmi3ExitInitializationMode, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi3Terminate, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi3EnterStepMode, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi3Reset, (void *c))
{
    fmu_start(&((instance_t *)c)->data);
    return OK;
}

/* --- variables */

FUNCTION(status_t, fmi3GetFloat64, (void *c, const ref_t refs[], size_t count, double values[], size_t size))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_get_real(&one->data, refs[i], &values[i])) {
            return refused(one, "fmi3GetFloat64: there is no such Float64");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi3SetFloat64, (void *c, const ref_t refs[], size_t count, const double values[], size_t size))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_set_real(&one->data, refs[i], values[i])) {
            return refused(one, "fmi3SetFloat64: only inputs can be set, and only to finite numbers");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi3GetBoolean, (void *c, const ref_t refs[], size_t count, bool values[], size_t size))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_get_boolean(&one->data, refs[i], &values[i])) {
            return refused(one, "fmi3GetBoolean: there is no such Boolean");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi3SetBoolean, (void *c, const ref_t refs[], size_t count, const bool values[], size_t size))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_set_boolean(&one->data, refs[i], values[i])) {
            return refused(one, "fmi3SetBoolean: only inputs can be set");
        }
    }
    return OK;
}

/* --- the state as a whole */

FUNCTION(status_t, fmi3GetFMUState, (void *c, void **state))
{
    if (*state == NULL) {
        *state = malloc(sizeof(fmu_data));
    }
    if (*state == NULL) {
        return refused((instance_t *)c, "fmi3GetFMUState: no memory");
    }
    memcpy(*state, &((instance_t *)c)->data, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi3SetFMUState, (void *c, void *state))
{
    memcpy(&((instance_t *)c)->data, state, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi3FreeFMUState, (void *c, void **state))
{
    free(*state);
    *state = NULL;
    return OK;
}

FUNCTION(status_t, fmi3SerializedFMUStateSize, (void *c, void *state, size_t *size))
{
    *size = sizeof(fmu_data);
    return OK;
}

FUNCTION(status_t, fmi3SerializeFMUState, (void *c, void *state, uint8_t bytes[], size_t size))
{
    if (size < sizeof(fmu_data)) {
        return refused((instance_t *)c, "fmi3SerializeFMUState: there is too little room");
    }
    memcpy(bytes, state, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi3DeserializeFMUState, (void *c, const uint8_t bytes[], size_t size, void **state))
{
    if (size != sizeof(fmu_data)) {
        return refused((instance_t *)c, "fmi3DeserializeFMUState: these are the bytes of something else");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(fmu_data));
    }
    if (*state == NULL) {
        return refused((instance_t *)c, "fmi3DeserializeFMUState: no memory");
    }
    memcpy(*state, bytes, sizeof(fmu_data));
    return OK;
}

/* --- the step */

FUNCTION(status_t, fmi3DoStep,
         (void *c, double time, double step, bool no_return, bool *needs_events, bool *ends, bool *is_early,
          double *reached))
{
    *needs_events = false;
    *ends = false;
    *is_early = false;
    const char *why = fmu_step(&((instance_t *)c)->data, time, step);
    *reached = why == NULL ? time + step : time;
    return why == NULL ? OK : refused((instance_t *)c, why);
}

FUNCTION(status_t, fmi3GetNumberOfVariableDependencies, (void *c, ref_t ref, size_t *count))
{
    *count = 0;
    return OK;
}

FUNCTION(status_t, fmi3GetVariableDependencies,
         (void *c, ref_t ref, size_t of[], ref_t on[], size_t parts[], int kinds[], size_t count))
{
    return OK;
}

/* --- what this has none of: variables of other types, clocks, events, derivatives, continuous states */

#define NONE(name, parameters)                                                                                         \
    FUNCTION(status_t, name, parameters)                                                                               \
    {                                                                                                                  \
        return count == 0 ? OK : refused((instance_t *)c, #name ": there is nothing of this kind");                    \
    }
#define NOT_PROVIDED(name, parameters)                                                                                 \
    FUNCTION(status_t, name, parameters)                                                                               \
    {                                                                                                                  \
        return refused((instance_t *)c, #name " is not provided");                                                     \
    }

NONE(fmi3GetFloat32, (void *c, const ref_t refs[], size_t count, float values[], size_t size))
NONE(fmi3SetFloat32, (void *c, const ref_t refs[], size_t count, const float values[], size_t size))
NONE(fmi3GetInt8, (void *c, const ref_t refs[], size_t count, int8_t values[], size_t size))
NONE(fmi3SetInt8, (void *c, const ref_t refs[], size_t count, const int8_t values[], size_t size))
NONE(fmi3GetUInt8, (void *c, const ref_t refs[], size_t count, uint8_t values[], size_t size))
NONE(fmi3SetUInt8, (void *c, const ref_t refs[], size_t count, const uint8_t values[], size_t size))
NONE(fmi3GetInt16, (void *c, const ref_t refs[], size_t count, int16_t values[], size_t size))
NONE(fmi3SetInt16, (void *c, const ref_t refs[], size_t count, const int16_t values[], size_t size))
NONE(fmi3GetUInt16, (void *c, const ref_t refs[], size_t count, uint16_t values[], size_t size))
NONE(fmi3SetUInt16, (void *c, const ref_t refs[], size_t count, const uint16_t values[], size_t size))
NONE(fmi3GetInt32, (void *c, const ref_t refs[], size_t count, int32_t values[], size_t size))
NONE(fmi3SetInt32, (void *c, const ref_t refs[], size_t count, const int32_t values[], size_t size))
NONE(fmi3GetUInt32, (void *c, const ref_t refs[], size_t count, uint32_t values[], size_t size))
NONE(fmi3SetUInt32, (void *c, const ref_t refs[], size_t count, const uint32_t values[], size_t size))
NONE(fmi3GetInt64, (void *c, const ref_t refs[], size_t count, int64_t values[], size_t size))
NONE(fmi3SetInt64, (void *c, const ref_t refs[], size_t count, const int64_t values[], size_t size))
NONE(fmi3GetUInt64, (void *c, const ref_t refs[], size_t count, uint64_t values[], size_t size))
NONE(fmi3SetUInt64, (void *c, const ref_t refs[], size_t count, const uint64_t values[], size_t size))
NONE(fmi3GetString, (void *c, const ref_t refs[], size_t count, const char *values[], size_t size))
NONE(fmi3SetString, (void *c, const ref_t refs[], size_t count, const char *const values[], size_t size))
NONE(fmi3GetBinary, (void *c, const ref_t refs[], size_t count, size_t sizes[], const uint8_t *values[], size_t size))
NONE(fmi3SetBinary,
     (void *c, const ref_t refs[], size_t count, const size_t sizes[], const uint8_t *const values[], size_t size))
NONE(fmi3GetClock, (void *c, const ref_t refs[], size_t count, bool values[]))
NONE(fmi3SetClock, (void *c, const ref_t refs[], size_t count, const bool values[]))
NONE(fmi3GetIntervalDecimal, (void *c, const ref_t refs[], size_t count, double intervals[], int kinds[]))
NONE(fmi3GetIntervalFraction,
     (void *c, const ref_t refs[], size_t count, uint64_t counters[], uint64_t resolutions[], int kinds[]))
NONE(fmi3GetShiftDecimal, (void *c, const ref_t refs[], size_t count, double shifts[]))
NONE(fmi3GetShiftFraction, (void *c, const ref_t refs[], size_t count, uint64_t counters[], uint64_t resolutions[]))
NONE(fmi3SetIntervalDecimal, (void *c, const ref_t refs[], size_t count, const double intervals[]))
NONE(fmi3SetIntervalFraction,
     (void *c, const ref_t refs[], size_t count, const uint64_t counters[], const uint64_t resolutions[]))
NONE(fmi3SetShiftDecimal, (void *c, const ref_t refs[], size_t count, const double shifts[]))
NONE(fmi3SetShiftFraction,
     (void *c, const ref_t refs[], size_t count, const uint64_t counters[], const uint64_t resolutions[]))
NONE(fmi3GetOutputDerivatives,
     (void *c, const ref_t refs[], size_t count, const int32_t orders[], double values[], size_t size))
NONE(fmi3SetContinuousStates, (void *c, const double values[], size_t count))
NONE(fmi3GetContinuousStates, (void *c, double values[], size_t count))
NONE(fmi3GetContinuousStateDerivatives, (void *c, double values[], size_t count))
NONE(fmi3GetNominalsOfContinuousStates, (void *c, double values[], size_t count))
NONE(fmi3GetEventIndicators, (void *c, double values[], size_t count))

FUNCTION(status_t, fmi3GetNumberOfEventIndicators, (void *c, size_t *count))
{
    *count = 0;
    return OK;
}

FUNCTION(status_t, fmi3GetNumberOfContinuousStates, (void *c, size_t *count))
{
    *count = 0;
    return OK;
}

NOT_PROVIDED(fmi3GetDirectionalDerivative,
             (void *c, const ref_t unknowns[], size_t unknown_count, const ref_t knowns[], size_t known_count,
              const double seed[], size_t seed_count, double sensitivity[], size_t sensitivity_count))
NOT_PROVIDED(fmi3GetAdjointDerivative,
             (void *c, const ref_t unknowns[], size_t unknown_count, const ref_t knowns[], size_t known_count,
              const double seed[], size_t seed_count, double sensitivity[], size_t sensitivity_count))
NOT_PROVIDED(fmi3EnterEventMode, (void *c))
NOT_PROVIDED(fmi3EnterConfigurationMode, (void *c))
NOT_PROVIDED(fmi3ExitConfigurationMode, (void *c))
NOT_PROVIDED(fmi3EvaluateDiscreteStates, (void *c))
NOT_PROVIDED(fmi3UpdateDiscreteStates,
             (void *c, bool *again, bool *ends, bool *nominals, bool *values, bool *has_next, double *next))
NOT_PROVIDED(fmi3EnterContinuousTimeMode, (void *c))
NOT_PROVIDED(fmi3CompletedIntegratorStep, (void *c, bool no_return, bool *has_event, bool *ends))
NOT_PROVIDED(fmi3SetTime, (void *c, double time))
NOT_PROVIDED(fmi3ActivateModelPartition, (void *c, ref_t clock, double time))
