/* Random calls of the exported controller, for libFuzzer.
 *
 *     airpuck export paper:M4 --to c -o out/c
 *     clang -g -O1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all -Iout/c \
 *         studies/fuzz_exported_c.c $(ls out/c/airpuck*.c | grep -v selftest) -lm -o out/fuzz
 *     out/fuzz -max_total_time=3600
 *
 * With --law mpc or --plan FILE the export contains the other laws.
 * Any bits may be a time, a pose or a command. Every step must give finite commands in range.
 * Afterwards the craft must fly again: poses at rest follow, for long enough to be believed. With
 * the predictive law that would take too long. */
#include "airpuck.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Read a number: raw bits, or a plausible one. */
static double number(const uint8_t **data, size_t *size, double scale)
{
    double result = 0;
    if (*size >= 3 && (*data)[0] < 200) {
        result = scale * ((*data)[1] * 256 + (*data)[2] - 32768) / 32768;
        *data += 3;
        *size -= 3;
    } else if (*size >= 9) {
        memcpy(&result, *data + 1, sizeof result);
        *data += 9;
        *size -= 9;
    } else {
        *size = 0;
    }
    return result;
}

/* Steps with poses at rest; the craft must fly in the last of them. */
enum { RECOVERY = 150, FLYING = 50 };
/* Motors that were told more spin for longer. */
#define PLAUSIBLE 10

static void recover(airpuck *craft, airpuck_target *targets, double now)
{
    const airpuck_real rest[3] = {0, 0, 0};
    airpuck_real command[AIRPUCK_MOTORS];
    airpuck_set_point(targets, 0, 0, 0);
    for (int k = 0; k < RECOVERY; k++) {
        now += 0.01;
        airpuck_pose(craft, now, rest);
        airpuck_status status = airpuck_step(craft, now, targets, command);
        if (k >= RECOVERY - FLYING && status > AIRPUCK_FALLBACK)
            abort();
        airpuck_sent(craft, now, command);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static airpuck craft;
    airpuck_target targets[AIRPUCK_TARGETS], *aim = AIRPUCK_INTERVALS > 0 ? NULL : targets;
    airpuck_real given[AIRPUCK_MOTORS > 3 ? AIRPUCK_MOTORS : 3], command[AIRPUCK_MOTORS];
    double now = 0;
    int plausible = AIRPUCK_STEPS == 0;
    airpuck_init(&craft);
    airpuck_set_point(targets, 0, 0, 0);
    while (size > 1) {
        int action = *data++ % 8;
        size--;
        double time = action == 7 ? number(&data, &size, 1) : now;
        now += 0.004;
        if (action < 3) {
            for (int i = 0; i < 3; i++)
                given[i] = (airpuck_real)number(&data, &size, 1);
            airpuck_pose(&craft, time, given);
        } else if (action == 3) {
            for (int i = 0; i < AIRPUCK_MOTORS; i++) {
                given[i] = (airpuck_real)number(&data, &size, 1);
                plausible &= !(given[i] > PLAUSIBLE || given[i] < -PLAUSIBLE);
            }
            airpuck_sent(&craft, time, given);
#if AIRPUCK_INTERVALS > 0
        } else if (action == 7) {
            airpuck_depart(&craft, time);
            aim = NULL;
#endif
        } else if (action == 4) {
            aim = targets;
            airpuck_set_point(targets, (airpuck_real)number(&data, &size, 1),
                              (airpuck_real)number(&data, &size, 1),
                              (airpuck_real)number(&data, &size, 9));
        } else {
            airpuck_step(&craft, time, aim, command);
            for (int i = 0; i < AIRPUCK_MOTORS; i++)
                if (!(command[i] >= airpuck_tuned.command_min &&
                      command[i] <= airpuck_tuned.command_max))
                    abort();
            airpuck_sent(&craft, time, command);
        }
    }
    if (plausible)
        recover(&craft, targets, now);
    return 0;
}
