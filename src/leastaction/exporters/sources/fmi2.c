/* FMI 2.0 for co-simulation: what the standard asks for, in its own words of types. */
#include <stdlib.h>
#include <string.h>

#include "motion.h"

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#if defined _WIN32 || defined __CYGWIN__
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* A shared library has the plain names; built into a program, several FMUs must not meet. */
#ifdef FMI2_OVERRIDE_FUNCTION_PREFIX
#define NAME(name) name
#else
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define NAME(name) JOIN(MODEL_PREFIX, name)
#endif

typedef struct {
    Motion motion;
    fmi2CallbackFunctions callbacks;
    char *name;
} Instance;

static fmi2Status report(const Instance *instance, fmi2Status status, const char *message)
{
    if (message == NULL) return fmi2OK;
    if (instance->callbacks.logger != NULL)
        instance->callbacks.logger(instance->callbacks.componentEnvironment, instance->name, status,
                                   status == fmi2Discard ? "logStatusDiscard" : "logStatusError", "%s", message);
    return status;
}

EXPORT const char *NAME(fmi2GetTypesPlatform)(void) { return "default"; }

EXPORT const char *NAME(fmi2GetVersion)(void) { return "2.0"; }

EXPORT fmi2Status NAME(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}

EXPORT fmi2Component NAME(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                           const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                           fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    Instance temporary = {.name = (char *)(name ? name : "")};
    if (callbacks != NULL) temporary.callbacks = *callbacks;
    if (type != fmi2CoSimulation) {
        report(&temporary, fmi2Error, "this FMU is for co-simulation only");
        return NULL;
    }
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        report(&temporary, fmi2Error, "the GUID is not that of this FMU; its parts do not belong together");
        return NULL;
    }
    Instance *const instance = calloc(1, sizeof *instance);
    char *const copy = malloc(strlen(temporary.name) + 1);
    if (instance == NULL || copy == NULL) {
        free(instance);
        free(copy);
        return NULL;
    }
    instance->callbacks = temporary.callbacks;
    instance->name = strcpy(copy, temporary.name);
    motion_reset(&instance->motion);
    return instance;
}

EXPORT void NAME(fmi2FreeInstance)(fmi2Component c)
{
    if (c != NULL) free(((Instance *)c)->name);
    free(c);
}

EXPORT fmi2Status NAME(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                            fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Instance *)c)->motion.value[TIME] = start;
    return fmi2OK;
}

static fmi2Status move(Instance *instance, Phase from, Phase to)
{
    if (instance->motion.phase != from) return report(instance, fmi2Error, "this call comes out of turn");
    instance->motion.phase = to;
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2EnterInitializationMode)(fmi2Component c) { return move(c, BEFORE, INITIALISING); }

EXPORT fmi2Status NAME(fmi2ExitInitializationMode)(fmi2Component c) { return move(c, INITIALISING, STEPPING); }

EXPORT fmi2Status NAME(fmi2Terminate)(fmi2Component c) { return move(c, STEPPING, ENDED); }

EXPORT fmi2Status NAME(fmi2Reset)(fmi2Component c)
{
    motion_reset(&((Instance *)c)->motion);
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    const char *wrong = NULL;
    for (size_t i = 0; i < n && wrong == NULL; i++)
        wrong = motion_get(&((Instance *)c)->motion, vr[i], &value[i]);
    return report(c, fmi2Error, wrong);
}

EXPORT fmi2Status NAME(fmi2SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    const char *wrong = NULL;
    for (size_t i = 0; i < n && wrong == NULL; i++)
        wrong = motion_set(&((Instance *)c)->motion, vr[i], value[i]);
    return report(c, fmi2Error, wrong);
}

/* All variables are real numbers. */
#define NONE_OF_TYPE(Type)                                                                                         \
    EXPORT fmi2Status NAME(fmi2Get##Type)(fmi2Component c, const fmi2ValueReference vr[], size_t n,                \
                                          fmi2##Type value[])                                                      \
    {                                                                                                              \
        (void)vr, (void)value;                                                                                     \
        return report(c, fmi2Error, n ? "this FMU has no variable of type " #Type : NULL);                         \
    }                                                                                                              \
    EXPORT fmi2Status NAME(fmi2Set##Type)(fmi2Component c, const fmi2ValueReference vr[], size_t n,                \
                                          const fmi2##Type value[])                                                \
    {                                                                                                              \
        (void)vr, (void)value;                                                                                     \
        return report(c, fmi2Error, n ? "this FMU has no variable of type " #Type : NULL);                         \
    }
NONE_OF_TYPE(Integer)
NONE_OF_TYPE(Boolean)
NONE_OF_TYPE(String)

EXPORT fmi2Status NAME(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL) *state = malloc(sizeof(Motion));
    if (*state == NULL) return report(c, fmi2Error, "out of memory");
    memcpy(*state, &((Instance *)c)->motion, sizeof(Motion));
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    if (state == NULL) return report(c, fmi2Error, "there is no state");
    memcpy(&((Instance *)c)->motion, state, sizeof(Motion));
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2DoStep)(fmi2Component c, fmi2Real from, fmi2Real size, fmi2Boolean no_way_back)
{
    (void)no_way_back;
    Motion *const motion = &((Instance *)c)->motion;
    const char *const wrong = motion_step(motion, from, size);
    return report(c, motion->stuck ? fmi2Discard : fmi2Error, wrong);
}

EXPORT fmi2Status NAME(fmi2CancelStep)(fmi2Component c)
{
    return report(c, fmi2Error, "steps are done when fmi2DoStep returns");
}

EXPORT fmi2Status NAME(fmi2GetStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind;
    *value = fmi2OK;
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2GetRealStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return report(c, fmi2Discard, "there is no such real status");
    *value = ((Instance *)c)->motion.value[TIME];
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2GetIntegerStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind, (void)value;
    return report(c, fmi2Discard, "there is no integer status");
}

EXPORT fmi2Status NAME(fmi2GetBooleanStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated) return report(c, fmi2Discard, "there is no such Boolean status");
    *value = ((Instance *)c)->motion.stuck;
    return fmi2OK;
}

EXPORT fmi2Status NAME(fmi2GetStringStatus)(fmi2Component c, fmi2StatusKind kind, fmi2String *value)
{
    (void)kind, (void)value;
    return report(c, fmi2Discard, "there is no status in words");
}

/* What the model description says that this FMU cannot do; the functions must be there. */
#define CANNOT(name, ...)                                                                                          \
    EXPORT fmi2Status NAME(name)(fmi2Component c, __VA_ARGS__)                                                     \
    {                                                                                                              \
        return report(c, fmi2Error, #name " is not supported");                                                    \
    }
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
CANNOT(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
CANNOT(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
CANNOT(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
CANNOT(fmi2GetDirectionalDerivative, const fmi2ValueReference of[], size_t n_of, const fmi2ValueReference by[],
       size_t n_by, const fmi2Real known[], fmi2Real unknown[])
CANNOT(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer degree[],
       const fmi2Real value[])
CANNOT(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer degree[],
       fmi2Real value[])
