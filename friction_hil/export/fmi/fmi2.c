/* The functions of FMI 2.0 for co-simulation. The standard: https://fmi-standard.org; types and names are its own. */

#include "fmu.h"

#include <stdlib.h>
#include <string.h>

#ifdef FMI2_FUNCTION_PREFIX
#define JOINED(prefix, name) prefix##name
#define JOIN(prefix, name) JOINED(prefix, name)
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
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

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } status_t;
typedef void (*logger_t)(void *, const char *, status_t, const char *, const char *, ...);
typedef struct {
    logger_t logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, status_t);
    void *environment;
} callbacks_t;
typedef struct {
    fmu_data data;
    logger_t logger;
    void *environment;
    char name[64];
} instance_t;

static status_t refused(instance_t *one, const char *why)
{
    if (one->logger != NULL) {
        one->logger(one->environment, one->name, ERROR, "logStatusError", "%s", why);
    }
    return ERROR;
}

/* A function: it is declared and then defined. */
#define FUNCTION(type, name, parameters)                                                                               \
    EXPORT type FMI(name) parameters;                                                                                  \
    EXPORT type FMI(name) parameters

FUNCTION(const char *, fmi2GetTypesPlatform, (void))
{
    return "default";
}

FUNCTION(const char *, fmi2GetVersion, (void))
{
    return "2.0";
}

FUNCTION(status_t, fmi2SetDebugLogging, (void *c, int is_on, size_t count, const char *const categories[]))
{
    return OK;
}

FUNCTION(void *, fmi2Instantiate,
         (const char *name, int kind, const char *token, const char *resources, const callbacks_t *callbacks, int
          is_visible, int is_logging))
{
    instance_t *one = (instance_t *)calloc(1, sizeof(instance_t));
    if (one == NULL) {
        return NULL;
    }
    if (callbacks != NULL) {
        one->logger = callbacks->logger;
        one->environment = callbacks->environment;
    }
    if (name != NULL) {
        strncpy(one->name, name, sizeof(one->name) - 1);
    }
    if (kind != 1 || token == NULL || strcmp(token, FMU_TOKEN) != 0) {
        (void)refused(one, "this binary is for co-simulation, and for a model description with the guid " FMU_TOKEN);
        free(one);
        return NULL;
    }
    fmu_start(&one->data);
    return one;
}

FUNCTION(void, fmi2FreeInstance, (void *c))
{
    free(c);
}

FUNCTION(status_t, fmi2SetupExperiment,
         (void *c, int has_tolerance, double tolerance, double start, int has_stop, double stop))
{
    ((instance_t *)c)->data.start_time = start;
    ((instance_t *)c)->data.reals[0] = start;
    return OK;
}

FUNCTION(status_t, fmi2EnterInitializationMode, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi2ExitInitializationMode, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi2Terminate, (void *c))
{
    return OK;
}

FUNCTION(status_t, fmi2Reset, (void *c))
{
    fmu_start(&((instance_t *)c)->data);
    return OK;
}

FUNCTION(status_t, fmi2GetReal, (void *c, const unsigned int refs[], size_t count, double values[]))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_get_real(&one->data, refs[i], &values[i])) {
            return refused(one, "fmi2GetReal: there is no such Real");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi2SetReal, (void *c, const unsigned int refs[], size_t count, const double values[]))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_set_real(&one->data, refs[i], values[i])) {
            return refused(one, "fmi2SetReal: only inputs can be set, and only to finite numbers");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi2GetBoolean, (void *c, const unsigned int refs[], size_t count, int values[]))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        bool value = false;
        if (!fmu_get_boolean(&one->data, refs[i], &value)) {
            return refused(one, "fmi2GetBoolean: there is no such Boolean");
        }
        values[i] = value ? 1 : 0;
    }
    return OK;
}

FUNCTION(status_t, fmi2SetBoolean, (void *c, const unsigned int refs[], size_t count, const int values[]))
{
    instance_t *one = (instance_t *)c;
    for (size_t i = 0; i < count; i++) {
        if (!fmu_set_boolean(&one->data, refs[i], values[i] != 0)) {
            return refused(one, "fmi2SetBoolean: only inputs can be set");
        }
    }
    return OK;
}

FUNCTION(status_t, fmi2GetFMUstate, (void *c, void **state))
{
    if (*state == NULL) {
        *state = malloc(sizeof(fmu_data));
    }
    if (*state == NULL) {
        return refused((instance_t *)c, "fmi2GetFMUstate: no memory");
    }
    memcpy(*state, &((instance_t *)c)->data, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi2SetFMUstate, (void *c, void *state))
{
    memcpy(&((instance_t *)c)->data, state, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi2FreeFMUstate, (void *c, void **state))
{
    free(*state);
    *state = NULL;
    return OK;
}

FUNCTION(status_t, fmi2SerializedFMUstateSize, (void *c, void *state, size_t *size))
{
    *size = sizeof(fmu_data);
    return OK;
}

FUNCTION(status_t, fmi2SerializeFMUstate, (void *c, void *state, char bytes[], size_t size))
{
    if (size < sizeof(fmu_data)) {
        return refused((instance_t *)c, "fmi2SerializeFMUstate: there is too little room");
    }
    memcpy(bytes, state, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi2DeSerializeFMUstate, (void *c, const char bytes[], size_t size, void **state))
{
    if (size != sizeof(fmu_data)) {
        return refused((instance_t *)c, "fmi2DeSerializeFMUstate: these are the bytes of something else");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(fmu_data));
    }
    if (*state == NULL) {
        return refused((instance_t *)c, "fmi2DeSerializeFMUstate: no memory");
    }
    memcpy(*state, bytes, sizeof(fmu_data));
    return OK;
}

FUNCTION(status_t, fmi2DoStep, (void *c, double time, double step, int is_final))
{
    const char *why = fmu_step(&((instance_t *)c)->data, time, step);
    return why == NULL ? OK : refused((instance_t *)c, why);
}

/* --- what this has none of: variables of other types, derivatives, steps in the background */

#define NONE(name, parameters)                                                                                         \
    FUNCTION(status_t, name, parameters)                                                                               \
    {                                                                                                                  \
        return count == 0 ? OK : refused((instance_t *)c, #name ": there is nothing of this kind");                    \
    }
#define DISCARDED(name, parameters)                                                                                    \
    FUNCTION(status_t, name, parameters)                                                                               \
    {                                                                                                                  \
        return DISCARD;                                                                                                \
    }

NONE(fmi2GetInteger, (void *c, const unsigned int refs[], size_t count, int values[]))
NONE(fmi2SetInteger, (void *c, const unsigned int refs[], size_t count, const int values[]))
NONE(fmi2GetString, (void *c, const unsigned int refs[], size_t count, const char *values[]))
NONE(fmi2SetString, (void *c, const unsigned int refs[], size_t count, const char *const values[]))
NONE(fmi2SetRealInputDerivatives,
     (void *c, const unsigned int refs[], size_t count, const int orders[], const double values[]))
NONE(fmi2GetRealOutputDerivatives,
     (void *c, const unsigned int refs[], size_t count, const int orders[], double values[]))
NONE(fmi2GetDirectionalDerivative,
     (void *c, const unsigned int unknowns[], size_t count, const unsigned int knowns[], size_t known_count,
      const double seed[], double sensitivity[]))
DISCARDED(fmi2CancelStep, (void *c))
DISCARDED(fmi2GetStatus, (void *c, int kind, status_t *value))
DISCARDED(fmi2GetRealStatus, (void *c, int kind, double *value))
DISCARDED(fmi2GetIntegerStatus, (void *c, int kind, int *value))
DISCARDED(fmi2GetBooleanStatus, (void *c, int kind, int *value))
DISCARDED(fmi2GetStringStatus, (void *c, int kind, const char **value))
