/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Functions that FMI 3.0 requires, but that a co-simulation FMU without events, clocks and further
 * types does not support: they return an error. */
#include "fmi3Functions.h"

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

typedef fmi3ValueReference reference;

#define ABSENT(name, ...) \
    fmi3Status name(fmi3Instance instance, __VA_ARGS__) \
    { \
        return fmi3Error; \
    }
#define ABSENT_ALONE(name) \
    fmi3Status name(fmi3Instance instance) \
    { \
        return fmi3Error; \
    }
/* There is no variable of this type: only an empty list can be read or set. */
#define NO_VARIABLES(type) \
    fmi3Status fmi3Get##type(fmi3Instance instance, const reference references[], size_t count, \
                             fmi3##type values[], size_t n) \
    { \
        return instance && !count && !n ? fmi3OK : fmi3Error; \
    } \
    fmi3Status fmi3Set##type(fmi3Instance instance, const reference references[], size_t count, \
                             const fmi3##type values[], size_t n) \
    { \
        return instance && !count && !n ? fmi3OK : fmi3Error; \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)
ABSENT(fmi3GetBinary, const reference references[], size_t count, size_t sizes[],
       fmi3Binary values[], size_t n)
ABSENT(fmi3SetBinary, const reference references[], size_t count, const size_t sizes[],
       const fmi3Binary values[], size_t n)
ABSENT(fmi3GetClock, const reference references[], size_t count, fmi3Clock values[])
ABSENT(fmi3SetClock, const reference references[], size_t count, const fmi3Clock values[])

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logs,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logs,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

ABSENT(fmi3GetNumberOfVariableDependencies, reference dependent, size_t *count)
ABSENT(fmi3GetVariableDependencies, reference dependent, size_t elements[],
       reference independents[], size_t independent_elements[], fmi3DependencyKind kinds[],
       size_t count)
ABSENT(fmi3SerializedFMUStateSize, fmi3FMUState state, size_t *size)
ABSENT(fmi3SerializeFMUState, fmi3FMUState state, fmi3Byte serialized[], size_t size)
ABSENT(fmi3DeserializeFMUState, const fmi3Byte serialized[], size_t size, fmi3FMUState *state)
ABSENT(fmi3GetDirectionalDerivative, const reference unknowns[], size_t n_unknowns,
       const reference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
       fmi3Float64 sensitivity[], size_t n)
ABSENT(fmi3GetAdjointDerivative, const reference unknowns[], size_t n_unknowns,
       const reference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
       fmi3Float64 sensitivity[], size_t n)
ABSENT(fmi3GetOutputDerivatives, const reference references[], size_t count,
       const fmi3Int32 orders[], fmi3Float64 values[], size_t n)

ABSENT_ALONE(fmi3EnterConfigurationMode)
ABSENT_ALONE(fmi3ExitConfigurationMode)
ABSENT_ALONE(fmi3EnterEventMode)
ABSENT_ALONE(fmi3EnterStepMode)
ABSENT_ALONE(fmi3EnterContinuousTimeMode)
ABSENT_ALONE(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates, fmi3Boolean *again, fmi3Boolean *terminates,
       fmi3Boolean *nominals_changed, fmi3Boolean *values_changed, fmi3Boolean *event,
       fmi3Float64 *event_time)
ABSENT(fmi3CompletedIntegratorStep, fmi3Boolean no_earlier_state, fmi3Boolean *event,
       fmi3Boolean *terminates)
ABSENT(fmi3SetTime, fmi3Float64 time)
ABSENT(fmi3SetContinuousStates, const fmi3Float64 states[], size_t n)
ABSENT(fmi3GetContinuousStates, fmi3Float64 states[], size_t n)
ABSENT(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
ABSENT(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
ABSENT(fmi3GetNumberOfContinuousStates, size_t *n)
ABSENT(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
ABSENT(fmi3GetNumberOfEventIndicators, size_t *n)
ABSENT(fmi3GetIntervalDecimal, const reference references[], size_t count, fmi3Float64 intervals[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetIntervalFraction, const reference references[], size_t count, fmi3UInt64 counters[],
       fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetShiftDecimal, const reference references[], size_t count, fmi3Float64 shifts[])
ABSENT(fmi3GetShiftFraction, const reference references[], size_t count, fmi3UInt64 counters[],
       fmi3UInt64 resolutions[])
ABSENT(fmi3SetIntervalDecimal, const reference references[], size_t count,
       const fmi3Float64 intervals[])
ABSENT(fmi3SetIntervalFraction, const reference references[], size_t count,
       const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3SetShiftDecimal, const reference references[], size_t count, const fmi3Float64 shifts[])
ABSENT(fmi3SetShiftFraction, const reference references[], size_t count,
       const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3ActivateModelPartition, reference clock, fmi3Float64 time)
