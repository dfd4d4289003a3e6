/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* A planned flight, and the law that tracks it. Included by airpuck.h. */
#ifndef AIRPUCK_FLIGHT_H
#define AIRPUCK_FLIGHT_H

/* Corrections to the planned thrusts, over all periods up to the point where the craft rejoins. */
#define AIRPUCK_CORRECTIONS (AIRPUCK_PERIODS * AIRPUCK_MOTORS)

/* The plan and the numbers of its tracker, fixed at export. Times of the plan are seconds from its
 * beginning. */
typedef struct {
    /* How far ahead on the plan the craft aims, how much later than planned it may come to rest,
     * and the shortest time in which motors and thrusts can have an effect [s]. */
    double ahead, later, least;
    airpuck_real lasting;      /* How long an estimated disturbance is assumed to last [s]. */
    airpuck_real precision[6]; /* Equally weighted errors of x, y, yaw and their rates there. */
    airpuck_real correction;   /* Deviation from planned thrusts with the same weight [N]. */
    airpuck_real difference;   /* Step of the finite differences that linearise accelerations. */
    int samples;               /* Per period, over which planned commands are averaged. */
    /* Newton's method: iterations, largest remaining slope; least decrease and shortest step of its
     * line search. */
    int iterations;
    airpuck_real tolerance, decrease, shortest;
    double rounding; /* Of a number of periods. */

    double duration, given_up; /* Its end, and when it is no longer tracked. */
    int rests;                 /* Whether the craft rests at the end. */
    double times[AIRPUCK_INTERVALS + 1]; /* Ends of the intervals of constant commands. */
    airpuck_real commands[AIRPUCK_INTERVALS][AIRPUCK_MOTORS];
    airpuck_real states[AIRPUCK_INTERVALS * AIRPUCK_PARTS + 1][AIRPUCK_STATES];
} airpuck_flight;

extern const airpuck_flight airpuck_planned;

#endif
