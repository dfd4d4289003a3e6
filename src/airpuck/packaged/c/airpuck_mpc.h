/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* The predictive law: commands over a horizon that track the targets best within all limits.
 *
 * Each step linearises the physics along the previous plan, shifted in time, and solves one
 * quadratic program for a better plan. Included by airpuck.h. */
#ifndef AIRPUCK_MPC_H
#define AIRPUCK_MPC_H

/* Decision variables, and limits of the motion over all steps. */
#define AIRPUCK_COMMANDS (AIRPUCK_MOTORS * AIRPUCK_BLOCKS)
#define AIRPUCK_ROWS (AIRPUCK_STEPS * AIRPUCK_LIMITS)

/* Limits that are active somewhere in a plan. */
enum {
    AIRPUCK_MOTOR_ACTIVE = 1,
    AIRPUCK_RAIL_ACTIVE = 2,
    AIRPUCK_SPEED_ACTIVE = 4,
    AIRPUCK_SPIN_ACTIVE = 8,
    AIRPUCK_DISC_ACTIVE = 16
};

/* Settings fixed at export; weights include the duration of a step. */
typedef struct {
    airpuck_real step;                  /* Duration of a step [s]. */
    int owner[AIRPUCK_STEPS];           /* The block of each step; a block has one command. */
    airpuck_real lasting[AIRPUCK_BLOCKS]; /* Duration of each block [s]. */
    airpuck_real weights[6];            /* Weights of squared errors of the state. */
    airpuck_real terminal[6][6];        /* Weight of the error at the end of the horizon. */
    airpuck_real effort[3];             /* Weights of squared accelerations. */
    airpuck_real used[AIRPUCK_BLOCKS];  /* Weights of squared commands above idle. */
    airpuck_real damping;               /* Weight of squared changes of a command. */
    airpuck_real first;                 /* Every command of the first plan. */
    airpuck_real brake;                 /* Acceleration available in all directions [m/s^2]. */
    airpuck_real headway;               /* How far ahead the fence must be kept [s]. */
    airpuck_real turning, most_room;    /* Distance to it per yaw rate, at most [m s/rad, m]. */
    airpuck_real undecided;             /* Above this yaw error, a direction is kept [rad]. */
    double flown_on;                    /* How long a plan goes on without an answer [s]. */
    airpuck_real speed, spin;           /* Speed and spin limits, if any [m/s, rad/s]. */
    airpuck_real fence[2][2];           /* Lowest and highest x, y of the craft's centre [m]. */
    airpuck_real keep_out[AIRPUCK_DISCS + 1][3]; /* Discs: x, y, distance [m]; one spare. */
    int iterations;                     /* Iteration limit of the solver. */
    airpuck_real penalty;               /* Weight of exceeding limits of the motion. */
} airpuck_horizon;

extern const airpuck_horizon airpuck_predicted;

/* The latest plan. `fence` and `keep_out` may be changed between steps. */
typedef struct {
    airpuck_real commands[AIRPUCK_BLOCKS][AIRPUCK_MOTORS];
    double since, answered; /* When the plan begins, and when the solver last found a plan. */
    airpuck_real way;       /* Yaw still to turn, in the chosen direction [rad]. */
    int limits;             /* Active limits; a sum of AIRPUCK_..._ACTIVE. */
    airpuck_real fence[2][2], keep_out[AIRPUCK_DISCS + 1][3];
    int astray; /* Whether the solver failed from the last active set. */
    /* States of the constraints; see airpuck_qp.h. */
    signed char active[AIRPUCK_COMMANDS + AIRPUCK_ROWS];
} airpuck_plan;

#endif
