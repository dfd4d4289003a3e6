/* Calls of an FMI unit that no sound tool makes: each must fail by its status, without a crash. */
#include "airpuck_plant.h"
#include "fmi3Functions.h"
#include <stdio.h>
#include <stdlib.h>

#define MUST(call, status) \
    do { \
        fmi3Status got = (call); \
        if (got != (status)) { \
            fprintf(stderr, "%s: %d instead of %d\n", #call, (int)got, (int)(status)); \
            exit(1); \
        } \
    } while (0)

static fmi3Boolean event, ends, early;
static double last;
static int messages;

static void count_message(fmi3InstanceEnvironment environment, fmi3Status status,
                          fmi3String category, fmi3String message)
{
    (void)environment, (void)status;
    messages += category && message && message[0];
}

static fmi3Instance instantiate(const char *token)
{
    return fmi3InstantiateCoSimulation("craft", token, "", fmi3False, fmi3True, fmi3False, fmi3False,
                                       NULL, 0, NULL, count_message, NULL);
}

static fmi3Status step(fmi3Instance unit, double point, double size)
{
    return fmi3DoStep(unit, point, size, fmi3True, &event, &ends, &early, &last);
}

static fmi3Status set(fmi3Instance unit, fmi3ValueReference reference, double value)
{
    return fmi3SetFloat64(unit, &reference, 1, &value, 1);
}

static fmi3Status get(fmi3Instance unit, fmi3ValueReference reference)
{
    double value;
    return fmi3GetFloat64(unit, &reference, 1, &value, 1);
}

int main(void)
{
    if (instantiate("another") || instantiate(NULL))
        return 1;
    fmi3Instance unit = instantiate(AIRPUCK_TOKEN);
    fmi3FMUState kept = NULL;
    fmi3ValueReference seed = AIRPUCK_SEED;
    fmi3Int32 whole = -1;

    /* Before the start: parameters only, within their ranges. */
    MUST(step(unit, 0, 0.01), fmi3Error);
    MUST(fmi3ExitInitializationMode(unit), fmi3Error);
    MUST(fmi3Terminate(unit), fmi3Error);
    MUST(set(unit, AIRPUCK_TABLE_LENGTH, -1), fmi3Discard);
    MUST(set(unit, AIRPUCK_CAMERA_RATE, 0), fmi3Discard);
    MUST(set(unit, AIRPUCK_RADIO_DELAY, NAN), fmi3Discard);
    MUST(set(unit, AIRPUCK_STATE, 0.1), fmi3Error);
    MUST(set(unit, AIRPUCK_TIME, 1), fmi3Error);
    MUST(set(unit, AIRPUCK_SEED, 1), fmi3Error);
    MUST(set(unit, AIRPUCK_VARIABLES, 1), fmi3Error);
    MUST(set(unit, UINT32_MAX, 1), fmi3Error);
    MUST(fmi3SetInt32(unit, &seed, 1, &whole, 1), fmi3Discard);
    MUST(fmi3GetFloat64(unit, NULL, 1, &last, 1), fmi3Error);
    MUST(fmi3GetFloat64(unit, &seed, 1, &last, 0), fmi3Error);
    MUST(fmi3EnterInitializationMode(unit, fmi3False, 0, NAN, fmi3False, 0), fmi3Error);

    /* The craft must start on its table. */
    MUST(set(unit, AIRPUCK_START_X, 500), fmi3OK);
    MUST(fmi3EnterInitializationMode(unit, fmi3False, 0, 5, fmi3False, 0), fmi3OK);
    MUST(get(unit, AIRPUCK_STATE), fmi3OK);
    MUST(fmi3ExitInitializationMode(unit), fmi3Error);
    MUST(set(unit, AIRPUCK_START_X, 0.01), fmi3OK);
    MUST(fmi3ExitInitializationMode(unit), fmi3OK);

    /* Steps forward from the last communication point only. */
    MUST(step(unit, 5, 0), fmi3Discard);
    MUST(step(unit, 5, -1), fmi3Discard);
    MUST(step(unit, 5, NAN), fmi3Discard);
    MUST(step(unit, 5, INFINITY), fmi3Discard);
    MUST(step(unit, NAN, 1), fmi3Error);
    MUST(step(unit, 0, 1), fmi3Error);
    MUST(fmi3DoStep(unit, 5, 1, fmi3True, NULL, NULL, NULL, NULL), fmi3Error);
    for (int i = 0; i < 3; i++) {
        const double values[] = {NAN, INFINITY, -INFINITY};
        MUST(set(unit, AIRPUCK_COMMAND, values[i]), fmi3Discard);
    }
    MUST(set(unit, AIRPUCK_COMMAND, 1e300), fmi3OK);
    MUST(set(unit, AIRPUCK_TABLE_LENGTH, 2), fmi3Error);
    MUST(step(unit, 5, 0.01), fmi3OK);
    MUST(fmi3EnterEventMode(unit), fmi3Error);
    MUST(fmi3EnterConfigurationMode(unit), fmi3Error);

    /* More commands in transit than there is room for. */
    MUST(fmi3GetFMUState(unit, &kept), fmi3OK);
    MUST(fmi3Reset(unit), fmi3OK);
    MUST(set(unit, AIRPUCK_RADIO_DELAY, 10), fmi3OK);
    MUST(set(unit, AIRPUCK_CAMERA_LATENCY, 10), fmi3OK);
    MUST(set(unit, AIRPUCK_CAMERA_RATE, 1), fmi3OK);
    MUST(fmi3EnterInitializationMode(unit, fmi3False, 0, 0, fmi3False, 0), fmi3OK);
    MUST(fmi3ExitInitializationMode(unit), fmi3OK);
    for (int i = 0; i < AIRPUCK_IN_TRANSIT; i++) {
        MUST(set(unit, AIRPUCK_COMMAND, 0.5), fmi3OK);
        MUST(step(unit, i / 512.0, 1 / 512.0), fmi3OK);
    }
    MUST(set(unit, AIRPUCK_COMMAND, 0.5), fmi3OK);
    MUST(step(unit, 2, 1), fmi3Error);
    MUST(step(unit, 2, 1), fmi3Error);
    MUST(set(unit, AIRPUCK_COMMAND, 0.5), fmi3Error);
    MUST(get(unit, AIRPUCK_STATE), fmi3OK);

    /* Back to the kept state. */
    MUST(fmi3SetFMUState(unit, NULL), fmi3Error);
    MUST(fmi3SetFMUState(unit, kept), fmi3OK);
    MUST(step(unit, 5.01, 20), fmi3OK);
    MUST(fmi3FreeFMUState(unit, &kept), fmi3OK);
    MUST(fmi3Terminate(unit), fmi3OK);
    MUST(step(unit, 25.01, 1), fmi3Error);

    /* No instance at all. */
    MUST(set(NULL, AIRPUCK_COMMAND, 0.5), fmi3Error);
    MUST(get(NULL, AIRPUCK_COMMAND), fmi3Error);
    MUST(step(NULL, 0, 1), fmi3Error);
    MUST(fmi3Reset(NULL), fmi3Error);
    MUST(fmi3GetFMUState(NULL, &kept), fmi3Error);
    fmi3FreeInstance(NULL);
    fmi3FreeInstance(unit);
    return messages ? 0 : 1;
}
