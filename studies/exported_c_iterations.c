/* Iterations of the exported controller over a long flight with random targets.
 *
 *     airpuck export paper:M4 --to c -o out/c
 *     gcc -std=c99 -O2 -Iout/c studies/exported_c_iterations.c \
 *         $(ls out/c/airpuck*.c | grep -v selftest) -lm -o out/iterations
 *     out/iterations 1000000
 *
 * The exported model flies the craft, with noise and pushes. Every 40 steps there is a new target,
 * near or far out of reach; a craft that leaves the table starts again in its middle. */
#include "airpuck.h"

#include <stdio.h>
#include <stdlib.h>

static double uniform(void)
{
    return 2.0 * rand() / RAND_MAX - 1;
}

int main(int count, char **words)
{
    static airpuck craft;
    static airpuck_target targets[AIRPUCK_TARGETS];
    airpuck_real state[6 + AIRPUCK_MOTORS] = {0}, command[AIRPUCK_MOTORS], pose[3];
    long steps = count > 1 ? atol(words[1]) : 100000, seen[AIRPUCK_BAD_INPUT + 1] = {0};
    double total = 0;
    int most = 0, histogram[8] = {0};
    airpuck_init(&craft);
    for (long k = 0; k < steps; k++) {
        double now = (double)k * (double)airpuck_tuned.period;
        if (k % 40 == 0) {
            double reach = k % 3 == 0 ? 0.01 : k % 3 == 1 ? 0.5 : 4;
            airpuck_set_point(targets, (airpuck_real)(reach * uniform()),
                              (airpuck_real)(reach * uniform()), (airpuck_real)(3 * uniform()));
            for (int i = 3; i < 6 && k % 7 == 0; i++)
                state[i] += (airpuck_real)(i < 5 ? 0.5 * uniform() : 5 * uniform());
        }
        for (int i = 0; i < 3; i++)
            pose[i] = state[i] + (airpuck_real)(1e-4 * uniform());
        airpuck_pose(&craft, now, pose);
        seen[airpuck_step(&craft, now, targets, command)]++;
        airpuck_sent(&craft, now, command);
        total += craft.iterations;
        most = craft.iterations > most ? craft.iterations : most;
        int bin = 0;
        while (bin < 7 && craft.iterations > 10 << bin)
            bin++;
        histogram[bin]++;
        airpuck_model_step(&airpuck_identified, state, command, airpuck_tuned.period);
        if (!(state[0] * state[0] < 1) || !(state[1] * state[1] < 1))
            for (int i = 0; i < 6; i++)
                state[i] = 0;
    }
    printf("%ld steps: iterations mean %.1f, most %d\n", steps, total / (double)steps, most);
    for (int bin = 0; bin < 8; bin++)
        printf("  %s %d: %d\n", bin < 7 ? "at most" : "more than", 10 << (bin < 7 ? bin : 6),
               histogram[bin]);
    for (int status = 0; status <= AIRPUCK_BAD_INPUT; status++)
        if (seen[status] > 0)
            printf("  %s: %ld\n", airpuck_status_name((airpuck_status)status), seen[status]);
    return 0;
}
