/* FMI 3.0 for co-simulation: what the standard asks for, in its own words of types. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "motion.h"

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum { fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent }
    fmi3DependencyKind;
typedef enum { fmi3NotYetKnown, fmi3Unchanged, fmi3Changed } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3AnyCallback)(void);

#if defined _WIN32 || defined __CYGWIN__
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* A shared library has the plain names; built into a program, several FMUs must not meet. */
#ifdef FMI3_OVERRIDE_FUNCTION_PREFIX
#define NAME(name) name
#else
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define NAME(name) JOIN(MODEL_PREFIX, name)
#endif

typedef struct {
    Motion motion;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

static fmi3Status report(const Instance *instance, fmi3Status status, const char *message)
{
    if (message == NULL) return fmi3OK;
    if (instance->log != NULL)
        instance->log(instance->environment, status,
                      status == fmi3Discard ? "logStatusDiscard" : "logStatusError", message);
    return status;
}

EXPORT const char *NAME(fmi3GetVersion)(void) { return "3.0"; }

EXPORT fmi3Status NAME(fmi3SetDebugLogging)(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return fmi3OK;
}

EXPORT fmi3Instance NAME(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean event_mode, fmi3Boolean early_return, const fmi3ValueReference intermediate[],
    size_t n_intermediate, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3AnyCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)n_intermediate, (void)update;
    const Instance temporary = {.environment = environment, .log = log};
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        report(&temporary, fmi3Error, "the token is not that of this FMU; its parts do not belong together");
        return NULL;
    }
    Instance *const instance = malloc(sizeof *instance);
    if (instance == NULL) return NULL;
    *instance = temporary;
    motion_reset(&instance->motion);
    return instance;
}

EXPORT fmi3Instance NAME(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                       fmi3Boolean visible, fmi3Boolean logging,
                                                       fmi3InstanceEnvironment environment,
                                                       fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    const Instance temporary = {.environment = environment, .log = log};
    report(&temporary, fmi3Error, "this FMU is for co-simulation only");
    return NULL;
}

EXPORT fmi3Instance NAME(fmi3InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3AnyCallback clock, fmi3AnyCallback lock,
    fmi3AnyCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)clock, (void)lock, (void)unlock;
    const Instance temporary = {.environment = environment, .log = log};
    report(&temporary, fmi3Error, "this FMU is for co-simulation only");
    return NULL;
}

EXPORT void NAME(fmi3FreeInstance)(fmi3Instance c) { free(c); }

static fmi3Status move(Instance *instance, Phase from, Phase to)
{
    if (instance->motion.phase != from) return report(instance, fmi3Error, "this call comes out of turn");
    instance->motion.phase = to;
    return fmi3OK;
}

EXPORT fmi3Status NAME(fmi3EnterInitializationMode)(fmi3Instance c, fmi3Boolean has_tolerance,
                                                    fmi3Float64 tolerance, fmi3Float64 start,
                                                    fmi3Boolean has_stop, fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Instance *)c)->motion.value[TIME] = start;
    return move(c, BEFORE, INITIALISING);
}

EXPORT fmi3Status NAME(fmi3ExitInitializationMode)(fmi3Instance c) { return move(c, INITIALISING, STEPPING); }

EXPORT fmi3Status NAME(fmi3EnterStepMode)(fmi3Instance c) { return move(c, STEPPING, STEPPING); }

EXPORT fmi3Status NAME(fmi3Terminate)(fmi3Instance c) { return move(c, STEPPING, ENDED); }

EXPORT fmi3Status NAME(fmi3Reset)(fmi3Instance c)
{
    motion_reset(&((Instance *)c)->motion);
    return fmi3OK;
}

EXPORT fmi3Status NAME(fmi3GetFloat64)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                       size_t n_values)
{
    const char *wrong = n == n_values ? NULL : "there must be as many values as value references";
    for (size_t i = 0; i < n && wrong == NULL; i++)
        wrong = motion_get(&((Instance *)c)->motion, vr[i], &value[i]);
    return report(c, fmi3Error, wrong);
}

EXPORT fmi3Status NAME(fmi3SetFloat64)(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                       const fmi3Float64 value[], size_t n_values)
{
    const char *wrong = n == n_values ? NULL : "there must be as many values as value references";
    for (size_t i = 0; i < n && wrong == NULL; i++)
        wrong = motion_set(&((Instance *)c)->motion, vr[i], value[i]);
    return report(c, fmi3Error, wrong);
}

EXPORT fmi3Status NAME(fmi3GetFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    if (*state == NULL) *state = malloc(sizeof(Motion));
    if (*state == NULL) return report(c, fmi3Error, "out of memory");
    memcpy(*state, &((Instance *)c)->motion, sizeof(Motion));
    return fmi3OK;
}

EXPORT fmi3Status NAME(fmi3SetFMUState)(fmi3Instance c, fmi3FMUState state)
{
    if (state == NULL) return report(c, fmi3Error, "there is no state");
    memcpy(&((Instance *)c)->motion, state, sizeof(Motion));
    return fmi3OK;
}

EXPORT fmi3Status NAME(fmi3FreeFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

EXPORT fmi3Status NAME(fmi3DoStep)(fmi3Instance c, fmi3Float64 from, fmi3Float64 size, fmi3Boolean no_way_back,
                                   fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                                   fmi3Float64 *last_time)
{
    (void)no_way_back;
    Motion *const motion = &((Instance *)c)->motion;
    const char *const wrong = motion_step(motion, from, size);
    *event = *early = false;
    *terminate = motion->stuck;
    *last_time = motion->value[TIME];
    return report(c, motion->stuck ? fmi3Discard : fmi3Error, wrong);
}

/* All variables are of type Float64, and the model description says what else this FMU cannot do. The
   functions must be there. */
#define CANNOT(name, ...)                                                                                          \
    EXPORT fmi3Status NAME(name)(fmi3Instance c, __VA_ARGS__)                                                      \
    {                                                                                                              \
        return report(c, fmi3Error, #name " is not supported");                                                    \
    }
#define REFERENCES const fmi3ValueReference vr[], size_t n
#define NONE_OF_TYPE(Type)                                                                                         \
    CANNOT(fmi3Get##Type, REFERENCES, fmi3##Type value[], size_t n_values)                                         \
    CANNOT(fmi3Set##Type, REFERENCES, const fmi3##Type value[], size_t n_values)
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NONE_OF_TYPE(Float32)
NONE_OF_TYPE(Int8)
NONE_OF_TYPE(UInt8)
NONE_OF_TYPE(Int16)
NONE_OF_TYPE(UInt16)
NONE_OF_TYPE(Int32)
NONE_OF_TYPE(UInt32)
NONE_OF_TYPE(Int64)
NONE_OF_TYPE(UInt64)
NONE_OF_TYPE(Boolean)
NONE_OF_TYPE(String)
CANNOT(fmi3GetBinary, REFERENCES, size_t sizes[], fmi3Binary value[], size_t n_values)
CANNOT(fmi3SetBinary, REFERENCES, const size_t sizes[], const fmi3Binary value[], size_t n_values)
CANNOT(fmi3GetClock, REFERENCES, fmi3Clock value[])
CANNOT(fmi3SetClock, REFERENCES, const fmi3Clock value[])
CANNOT(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 interval[], fmi3IntervalQualifier qualifier[])
CANNOT(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counter[], fmi3UInt64 resolution[],
       fmi3IntervalQualifier qualifier[])
CANNOT(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shift[])
CANNOT(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counter[], fmi3UInt64 resolution[])
CANNOT(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 interval[])
CANNOT(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
CANNOT(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shift[])
CANNOT(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
CANNOT(fmi3GetNumberOfVariableDependencies, fmi3ValueReference of, size_t *n)
CANNOT(fmi3GetVariableDependencies, fmi3ValueReference of, size_t of_element[], fmi3ValueReference by[],
       size_t by_element[], fmi3DependencyKind kind[], size_t n)
CANNOT(fmi3SerializedFMUStateSize, fmi3FMUState state, size_t *size)
CANNOT(fmi3SerializeFMUState, fmi3FMUState state, fmi3Byte bytes[], size_t size)
CANNOT(fmi3DeserializeFMUState, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
CANNOT(fmi3GetDirectionalDerivative, const fmi3ValueReference of[], size_t n_of, const fmi3ValueReference by[],
       size_t n_by, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 value[], size_t n_values)
CANNOT(fmi3GetAdjointDerivative, const fmi3ValueReference of[], size_t n_of, const fmi3ValueReference by[],
       size_t n_by, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 value[], size_t n_values)
CANNOT(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 degree[], fmi3Float64 value[], size_t n_values)
CANNOT(fmi3UpdateDiscreteStates, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
       fmi3Boolean *values, fmi3Boolean *has_next, fmi3Float64 *next)

/* Of the other kinds of FMU; importers look for them. */
CANNOT(fmi3SetTime, fmi3Float64 time)
CANNOT(fmi3SetContinuousStates, const fmi3Float64 value[], size_t n)
CANNOT(fmi3GetContinuousStates, fmi3Float64 value[], size_t n)
CANNOT(fmi3GetContinuousStateDerivatives, fmi3Float64 value[], size_t n)
CANNOT(fmi3GetNominalsOfContinuousStates, fmi3Float64 value[], size_t n)
CANNOT(fmi3GetEventIndicators, fmi3Float64 value[], size_t n)
CANNOT(fmi3GetNumberOfContinuousStates, size_t *n)
CANNOT(fmi3GetNumberOfEventIndicators, size_t *n)
CANNOT(fmi3CompletedIntegratorStep, fmi3Boolean no_way_back, fmi3Boolean *event, fmi3Boolean *terminate)
CANNOT(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

static fmi3Status no_such_mode(fmi3Instance c) { return report(c, fmi3Error, "this FMU has no such mode"); }
EXPORT fmi3Status NAME(fmi3EnterEventMode)(fmi3Instance c) { return no_such_mode(c); }
EXPORT fmi3Status NAME(fmi3EnterConfigurationMode)(fmi3Instance c) { return no_such_mode(c); }
EXPORT fmi3Status NAME(fmi3ExitConfigurationMode)(fmi3Instance c) { return no_such_mode(c); }
EXPORT fmi3Status NAME(fmi3EnterContinuousTimeMode)(fmi3Instance c) { return no_such_mode(c); }
EXPORT fmi3Status NAME(fmi3EvaluateDiscreteStates)(fmi3Instance c) { return no_such_mode(c); }
