/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* The plant as an FMI 3.0 co-simulation unit: instances, modes, access to variables. */
#include "airpuck_plant.h"
#include "fmi3Functions.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Longest simulated time [s]: up to here, event times are exact to a nanosecond. */
static const double LONGEST = 1e6;
/* Communication points that differ by less count as equal [s]. */
static const double SAME_TIME = 1e-9;

typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED } fmu_mode;

/* What fmi3GetFMUState copies. */
typedef struct {
    fmu_mode mode;
    double start_time;
    /* Whether a command was set since the last step. */
    int commanded;
    airpuck_plant plant;
} fmu_state;

typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3Boolean logs;
    fmu_state state;
} fmu;

/* Report a problem with an instance, and return its status. */
static fmi3Status failed(const fmu *unit, fmi3Status status, const char *function,
                         const char *problem)
{
    char message[256];
    if (unit && unit->log && unit->logs) {
        snprintf(message, sizeof message, "%s: %s", function, problem);
        unit->log(unit->environment, status, "logStatusError", message);
    }
    return status;
}

/* Check that a call is allowed in the present mode. */
static fmi3Status check_mode(const fmu *unit, const char *function, int allowed)
{
    if (!unit)
        return fmi3Error;
    return allowed ? fmi3OK : failed(unit, fmi3Error, function, "not allowed in this mode");
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    fmu *unit = instance;
    if (!unit || (nCategories && !categories))
        return fmi3Error;
    for (size_t i = 0; i < nCategories; i++)
        if (!categories[i] || strcmp(categories[i], "logStatusError"))
            return failed(unit, fmi3Error, "fmi3SetDebugLogging", "unknown category");
    unit->logs = loggingOn;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)instanceName, (void)resourcePath, (void)visible, (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables, (void)intermediateUpdate;
    static const char function[] = "fmi3InstantiateCoSimulation";
    const char *problem = NULL;
    fmu *unit = calloc(1, sizeof *unit);
    if (!unit)
        return NULL;
    unit->environment = instanceEnvironment;
    unit->log = logMessage;
    unit->logs = fmi3True;
    if (!instantiationToken || strcmp(instantiationToken, AIRPUCK_TOKEN))
        problem = "the instantiation token is not that of modelDescription.xml";
    else if (eventModeUsed || nRequiredIntermediateVariables)
        problem = "neither event mode nor intermediate variables are supported";
    if (problem) {
        failed(unit, fmi3Error, function, problem);
        free(unit);
        return NULL;
    }
    unit->logs = loggingOn;
    fmi3Reset(unit);
    return unit;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    fmu *unit = instance;
    (void)toleranceDefined, (void)tolerance, (void)stopTimeDefined, (void)stopTime;
    if (check_mode(unit, "fmi3EnterInitializationMode", unit && unit->state.mode == INSTANTIATED))
        return fmi3Error;
    if (!(fabs(startTime) <= LONGEST))
        return failed(unit, fmi3Error, "fmi3EnterInitializationMode", "start time beyond 1e6 s");
    unit->state.start_time = startTime;
    unit->state.mode = INITIALIZATION;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    fmu *unit = instance;
    if (check_mode(unit, "fmi3ExitInitializationMode",
                   unit && unit->state.mode == INITIALIZATION))
        return fmi3Error;
    const char *problem = airpuck_plant_start(&unit->state.plant);
    if (problem)
        return failed(unit, fmi3Error, "fmi3ExitInitializationMode", problem);
    unit->state.mode = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    fmu *unit = instance;
    if (check_mode(unit, "fmi3Terminate", unit && unit->state.mode == STEPPING))
        return fmi3Error;
    unit->state.mode = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    fmu *unit = instance;
    if (!unit)
        return fmi3Error;
    unit->state.mode = INSTANTIATED;
    unit->state.start_time = 0;
    unit->state.commanded = 0;
    airpuck_plant_reset(&unit->state.plant);
    return fmi3OK;
}

/* Check value references, which lie in [first, end), and the length of arrays. */
static fmi3Status check_references(const fmu *unit, const char *function,
                                   const fmi3ValueReference references[], size_t count,
                                   const void *values, size_t n_values, fmi3ValueReference first,
                                   fmi3ValueReference end)
{
    if (!unit)
        return fmi3Error;
    if (count != n_values || (count && (!references || !values)))
        return failed(unit, fmi3Error, function, "needs one value for each value reference");
    for (size_t i = 0; i < count; i++)
        if (references[i] < first || references[i] >= end)
            return failed(unit, fmi3Error, function, "no variable of this type has the reference");
    return fmi3OK;
}

/* Check that a variable may be set to a value now. */
static fmi3Status check_value(const fmu *unit, const char *function, fmi3ValueReference reference,
                              double value)
{
    const airpuck_variable *variable = &airpuck_variables[reference];
    char problem[160];
    int early = unit->state.mode == INSTANTIATED || unit->state.mode == INITIALIZATION;
    int input = variable->causality == 'i';
    if (!(input || (variable->causality == 'p' && early)) || unit->state.mode == TERMINATED) {
        snprintf(problem, sizeof problem, "%.60s cannot be set now", variable->name);
        return failed(unit, fmi3Error, function, problem);
    }
    /* Commands outside their range are clipped, as by a real radio. */
    if (input ? isfinite(value) : value >= variable->low && value <= variable->high)
        return fmi3OK;
    snprintf(problem, sizeof problem, "%.60s = %g is not between %g and %g", variable->name, value,
             variable->low, variable->high);
    return failed(unit, fmi3Discard, function, problem);
}

/* Set a variable to a checked value. */
static void set(fmu *unit, fmi3ValueReference reference, double value)
{
    if (airpuck_variables[reference].causality == 'i') {
        value = fmin(fmax(value, 0), 1);
        unit->state.commanded = 1;
    }
    unit->state.plant.value[reference] = value;
}

/* During initialisation the outputs follow from the present parameters. */
static const double *values_of(fmu *unit)
{
    if (unit->state.mode == INITIALIZATION)
        airpuck_plant_start(&unit->state.plant);
    return unit->state.plant.value;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    fmu *unit = instance;
    if (check_references(unit, "fmi3GetFloat64", valueReferences, nValueReferences, values, nValues,
                         0, AIRPUCK_REALS))
        return fmi3Error;
    const double *all = values_of(unit);
    for (size_t i = 0; i < nValues; i++)
        values[i] = all[valueReferences[i]];
    /* The plant's time begins at 0. */
    for (size_t i = 0; i < nValues; i++)
        if (airpuck_variables[valueReferences[i]].causality == 't')
            values[i] += unit->state.start_time;
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues)
{
    static const char function[] = "fmi3SetFloat64";
    fmu *unit = instance;
    fmi3Status status = check_references(unit, function, valueReferences, nValueReferences, values,
                                         nValues, 0, AIRPUCK_REALS);
    for (size_t i = 0; !status && i < nValues; i++)
        status = check_value(unit, function, valueReferences[i], values[i]);
    for (size_t i = 0; !status && i < nValues; i++)
        set(unit, valueReferences[i], values[i]);
    return status;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, fmi3Int32 values[], size_t nValues)
{
    fmu *unit = instance;
    if (check_references(unit, "fmi3GetInt32", valueReferences, nValueReferences, values, nValues,
                         AIRPUCK_REALS, AIRPUCK_VARIABLES))
        return fmi3Error;
    const double *all = values_of(unit);
    for (size_t i = 0; i < nValues; i++)
        values[i] = (fmi3Int32)fmin(all[valueReferences[i]], INT32_MAX);
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, const fmi3Int32 values[], size_t nValues)
{
    static const char function[] = "fmi3SetInt32";
    fmu *unit = instance;
    fmi3Status status = check_references(unit, function, valueReferences, nValueReferences, values,
                                         nValues, AIRPUCK_REALS, AIRPUCK_VARIABLES);
    for (size_t i = 0; !status && i < nValues; i++)
        status = check_value(unit, function, valueReferences[i], values[i]);
    for (size_t i = 0; !status && i < nValues; i++)
        set(unit, valueReferences[i], values[i]);
    return status;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    static const char function[] = "fmi3DoStep";
    fmu *unit = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (check_mode(unit, function, unit && unit->state.mode == STEPPING))
        return fmi3Error;
    if (!eventHandlingNeeded || !terminateSimulation || !earlyReturn || !lastSuccessfulTime)
        return failed(unit, fmi3Error, function, "a pointer to a result is NULL");
    airpuck_plant *plant = &unit->state.plant;
    double begin = currentCommunicationPoint - unit->state.start_time;
    double end = begin + communicationStepSize;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = plant->value[AIRPUCK_TIME] + unit->state.start_time;
    if (!(fabs(begin - plant->value[AIRPUCK_TIME]) <= SAME_TIME))
        return failed(unit, fmi3Error, function,
                      "the step does not begin where the last one ended");
    if (!(communicationStepSize > 0 && end <= LONGEST))
        return failed(unit, fmi3Discard, function, "the step must be above 0 and end before 1e6 s");
    const char *problem = unit->state.commanded ? airpuck_plant_send(plant, begin) : NULL;
    unit->state.commanded = 0;
    if (!problem)
        problem = airpuck_plant_run(plant, end);
    if (problem) {
        unit->state.mode = TERMINATED;
        return failed(unit, fmi3Error, function, problem);
    }
    *lastSuccessfulTime = currentCommunicationPoint + communicationStepSize;
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    fmu *unit = instance;
    if (!unit || !FMUState)
        return fmi3Error;
    if (!*FMUState && !(*FMUState = malloc(sizeof unit->state)))
        return failed(unit, fmi3Error, "fmi3GetFMUState", "no memory");
    memcpy(*FMUState, &unit->state, sizeof unit->state);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    fmu *unit = instance;
    if (!unit || !FMUState)
        return fmi3Error;
    memcpy(&unit->state, FMUState, sizeof unit->state);
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    if (!instance)
        return fmi3Error;
    if (FMUState) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}
