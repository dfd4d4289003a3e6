/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Repeats the flight in golden.csv and compares statuses and commands.
 *
 * Lines: `target,x,y,yaw`, `depart,time` (of a planned flight), `pose,stamp,x,y,yaw`,
 * `sent,time,command...`, and `step,now,status,command...` with what the controller in Python
 * computed. For the predictive law, `plan,since,answered,way,commands...` is the plan before a step.
 * It is copied, because rounding would otherwise accumulate from plan to plan. */
#include "airpuck.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef AIRPUCK_SINGLE
#define TOLERANCE 1e-3
/* The Hessian of a prediction has a condition of 1e4, near the digits of a float. */
#define MOST_UNEQUAL (AIRPUCK_STEPS > 0 ? 0.05 : 0.01)
#else
#define TOLERANCE 1e-7
#define MOST_UNEQUAL 0.0
#endif

static airpuck craft;

/* Read comma-separated numbers; return how many there are. */
static int numbers(const char *text, airpuck_real *result, int count)
{
    int found = 0;
    for (char *end; found < count; text = end + 1) {
        result[found++] = (airpuck_real)strtod(text, &end);
        if (*end != ',')
            break;
    }
    return found;
}

#if AIRPUCK_STEPS > 0
#define LINE (32 * (AIRPUCK_COMMANDS + 10))

static void copy_plan(const char *text)
{
    char *rest;
    airpuck_plan *plan = &craft.plan;
    plan->since = strtod(text, &rest);
    plan->answered = strtod(rest + 1, &rest);
    plan->way = (airpuck_real)strtod(rest + 1, &rest);
    for (int b = 0; b < AIRPUCK_BLOCKS; b++)
        for (int i = 0; i < AIRPUCK_MOTORS; i++)
            plan->commands[b][i] = (airpuck_real)strtod(rest + 1, &rest);
}
#else
#define LINE (32 * (AIRPUCK_MOTORS + 10))

static void copy_plan(const char *text)
{
    (void)text;
}
#endif

static char line[LINE];

int main(int count, char **words)
{
    airpuck_target targets[AIRPUCK_TARGETS], *aim = targets;
    airpuck_real given[AIRPUCK_MOTORS > 3 ? AIRPUCK_MOTORS : 3], command[AIRPUCK_MOTORS];
    char *rest;
    int steps = 0, unequal = 0;
    double worst = 0;
    FILE *file = fopen(count > 1 ? words[1] : "golden.csv", "r");
    if (file == NULL) {
        fprintf(stderr, "cannot open golden.csv\n");
        return 2;
    }
    airpuck_init(&craft);
    airpuck_set_point(targets, 0, 0, 0);
    while (fgets(line, sizeof line, file) != NULL) {
        char *value = strchr(line, ',') + 1;
        if (line[0] == 't') {
            numbers(value, given, 3);
            airpuck_set_point(targets, given[0], given[1], given[2]);
            aim = targets;
            continue;
        }
#if AIRPUCK_INTERVALS > 0
        if (line[0] == 'd') {
            airpuck_depart(&craft, strtod(value, NULL));
            aim = NULL;
            continue;
        }
#endif
        if (line[0] == 'p' && line[1] == 'l') {
            copy_plan(value);
            continue;
        }
        double time = strtod(value, &rest);
        if (line[0] == 'p') {
            numbers(rest + 1, given, 3);
            airpuck_pose(&craft, time, given);
        } else if (strncmp(line, "sent", 4) == 0) {
            numbers(rest + 1, given, AIRPUCK_MOTORS);
            airpuck_sent(&craft, time, given);
        } else {
            const char *name = airpuck_status_name(airpuck_step(&craft, time, aim, command));
            int same = strncmp(rest + 1, name, strlen(name)) == 0;
            numbers(strchr(rest + 1, ',') + 1, given, AIRPUCK_MOTORS);
            double difference = 0;
            for (int i = 0; i < AIRPUCK_MOTORS; i++)
                difference = fmax(difference, fabs((double)command[i] - (double)given[i]));
            worst = same && difference > worst ? difference : worst;
            unequal += !same || difference > TOLERANCE;
            steps++;
        }
    }
    fclose(file);
    printf("the controller's state takes %zu bytes\n", sizeof craft);
    printf("%d steps, %d different, largest difference of a command %.2g\n", steps, unequal, worst);
    return steps == 0 || unequal > MOST_UNEQUAL * steps;
}
