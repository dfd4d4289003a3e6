/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* A planned flight, and the law that tracks it. Included by airpuck.h. */
#ifndef AIRPUCK_FLIGHT_H
#define AIRPUCK_FLIGHT_H

/* Corrections to the planned thrusts, over all periods up to the point where the craft rejoins. */
#define AIRPUCK_CORRECTIONS (AIRPUCK_PERIODS * AIRPUCK_MOTORS)

/* The plan, fixed at export. Times are seconds from its beginning. */
typedef struct {
    double duration, given_up; /* Its end, and when it is no longer tracked. */
    int rests;                 /* Whether the craft rests at the end. */
    double times[AIRPUCK_INTERVALS + 1]; /* Ends of the intervals of constant commands. */
    airpuck_real commands[AIRPUCK_INTERVALS][AIRPUCK_MOTORS];
    airpuck_real states[AIRPUCK_INTERVALS * AIRPUCK_PARTS + 1][AIRPUCK_STATES];
} airpuck_flight;

extern const airpuck_flight airpuck_planned;

#endif
