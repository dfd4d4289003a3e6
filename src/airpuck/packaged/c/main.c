/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Reads poses from standard input and writes commands.
 *
 * Input lines: `time x y yaw`, or `target x y yaw`; with a plan also `depart time`. Output lines:
 * time, status, a command for each motor. Write your own program after this one: it receives poses
 * from your motion capture and sends commands to your motors. */
#include "airpuck.h"

#include <stdio.h>

static airpuck craft;

int main(void)
{
    airpuck_target targets[AIRPUCK_TARGETS], *aim = AIRPUCK_INTERVALS > 0 ? NULL : targets;
    airpuck_real command[AIRPUCK_MOTORS];
    double time, x, y, yaw, last = -(double)INFINITY;
    char line[200];

    airpuck_init(&craft);
    airpuck_set_point(targets, 0, 0, 0);
    while (fgets(line, sizeof line, stdin) != NULL) {
        if (sscanf(line, "target %lf %lf %lf", &x, &y, &yaw) == 3) {
            airpuck_set_point(targets, (airpuck_real)x, (airpuck_real)y, (airpuck_real)yaw);
            aim = targets;
#if AIRPUCK_INTERVALS > 0
        } else if (sscanf(line, "depart %lf", &time) == 1) {
            airpuck_depart(&craft, time);
            aim = NULL;
#endif
        } else if (sscanf(line, "%lf %lf %lf %lf", &time, &x, &y, &yaw) == 4) {
            airpuck_real pose[3] = {(airpuck_real)x, (airpuck_real)y, (airpuck_real)yaw};
            airpuck_pose(&craft, time, pose);
            /* A time long before the last one is accepted, like its pose: the last one was wrong. */
            if (last - airpuck_tuned.longest_pause <= time &&
                time < last + (double)airpuck_tuned.period / 2)
                continue;
            airpuck_status status = airpuck_step(&craft, time, aim, command);
            airpuck_sent(&craft, time, command);
            last = time;
            printf("%.4f %s", time, airpuck_status_name(status));
            for (int i = 0; i < AIRPUCK_MOTORS; i++)
                printf(" %.4f", (double)command[i]);
            printf("\n");
        } else {
            fprintf(stderr, "expected 'time x y yaw' or 'target x y yaw': %s", line);
            return 1;
        }
    }
    return 0;
}
